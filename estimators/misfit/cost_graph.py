"""The cost of a problem as one CasADi graph, from the model's own equation of motion.

A second formulation of what :class:`~rotorfit.estimators.misfit.problem.Problem` computes: here CasADi solves the
equation of motion symbolically, reading by reading, and differentiates it. It is slower, and shares no derivative.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np

from rotorfit.base.array_types import ComplexArray
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.misfit.codegen import robust_cost
from rotorfit.estimators.misfit.parameter_space import ParameterSpace
from rotorfit.estimators.misfit.priors import normal_moments
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import at_frequency


def cost_graph(problem: Problem) -> ca.Function | None:
    """Cost of the fitted vector, ``(p,)``, as a CasADi function. None where a response is itself a root (orbits of a
    law of eccentricity), for structures given as matrices, other experiments, and priors that are not normal."""
    blocks = [_linear(block) for block in problem.blocks]
    priors = [normal_moments(prior.distribution) for prior in problem.priors]
    if None in blocks or None in priors:
        return None
    x = ca.MX.sym("x", problem.space.size)
    factors = problem.factors or (None,) * len(problem.blocks)
    cost: Any = 0.0
    for block, responses, gains in zip(problem.blocks, blocks, factors, strict=True):
        if responses is not None:
            real, imag = _misses(problem.space, responses, x, gains)
            if not block.independent:  # free of what their errors have in common
                mixing = block.unmixed(np.eye(responses.measured.size, dtype=complex))
                real, imag = real @ mixing.real - imag @ mixing.imag, real @ mixing.imag + imag @ mixing.real
            cost += ca.sum2(robust_cost(problem.loss, real**2 + imag**2)) / 2
    for prior, moments in zip(problem.priors, priors, strict=True):
        if moments is not None:
            cost += ((x[prior.entry] - moments[0]) / moments[1]) ** 2 / 2
    return ca.Function("cost", [x], [cost])


def _linear(block: Block) -> Responses | None:
    """The responses to forces that a block holds, None if they are others or their model has no closed graph."""
    base = block.linear
    if base is None or base.beside is not None:
        return None
    return None if base.model.shaft is not None or base.model.eccentricity_dependent else base


def _misses(space: ParameterSpace, block: Responses, x: Any, gains: ComplexArray | None) -> tuple[Any, Any]:
    """Predicted minus measured over sigma, real and imaginary parts, shapes ``(1, R)``."""
    places = np.where(
        space.index >= 0, space.index, space.size + np.arange(space.index.size).reshape(space.index.shape)
    )
    values = ca.vertcat(x, ca.DM(space.template.ravel()))[places.ravel(order="C").tolist()]
    theta = ca.reshape(values, space.index.shape[1], -1)[:, block.reading_group.tolist()]
    seen = np.zeros((len(block.model.coordinates), block.measured.size))
    seen[block.coordinate, np.arange(block.measured.size)] = 1.0
    force = block.force[block.line].T
    line = np.vstack([block.s[block.line].imag, block.speed[block.line], force.real, force.imag, seen])
    predicted = _reading(block.model, imposed=block.imposed).map(block.measured.size)(theta, line)
    real, imag = predicted[0, :], predicted[1, :]
    if gains is not None:
        power = ca.reshape(x[len(space.names) :], 1, -1)
        size, turn = ca.exp(power @ gains.real.T), power @ gains.imag.T
        c, s = size * ca.cos(turn), size * ca.sin(turn)
        real, imag = real * c - imag * s, real * s + imag * c
    sigma = block.sigma[None]
    return (real - block.measured.real[None]) / sigma, (imag - block.measured.imag[None]) / sigma


def _reading(model: RotorModel, *, imposed: bool) -> ca.Function:
    """One reading, real and imaginary part, from parameters, and frequency, speed, force and what is read."""
    theta, speed, eccentricity, matrices, factors = model.symbolic
    n = len(model.coordinates)
    w, force, seen = ca.SX.sym("w"), ca.SX.sym("force", 2 * n), ca.SX.sym("seen", n)
    real, imag = at_frequency([(matrix.re, matrix.im) for matrix in matrices], w)
    stiffness = ca.vertcat(ca.horzcat(real, -imag), ca.horzcat(imag, real))
    stiffness = ca.substitute(stiffness, eccentricity, 0.0)
    answer = stiffness @ force if imposed else ca.solve(ca.densify(stiffness), force)
    gain = [(1.0, 0.0) if imposed else (f.re, f.im) for f in factors]
    parts = [(answer[i] * c - answer[n + i] * s, answer[i] * s + answer[n + i] * c) for i, (c, s) in enumerate(gain)]
    read = [sum(seen[i] * part[k] for i, part in enumerate(parts)) for k in (0, 1)]
    return ca.Function("reading", [theta, ca.vertcat(w, speed, force, seen)], [ca.vertcat(*read)])
