"""Starts for rotors whose fluid changes with eccentricity, and for tests that have no closed form."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from types import SimpleNamespace

import casadi as ca
import numpy as np

from rotorfit.estimators.blocks.nonlinear import OrbitResponses
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.blocks.small_motion import FreeVibrations, OffCentreResponses
from rotorfit.estimators.misfit.parameter_space import ParameterSpace
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.estimators.starting.closed_form import ClosedFormError, closed_forms
from rotorfit.models import Constant, Law
from rotorfit.models.array_types import Float

_LINEAR_ECCENTRICITY = 0.3  # eccentricity up to which the linear rotor is taken to hold for a start
_STIFFNESS_SHARES = (1.0, 0.4, 1.6)  # of K0 in the sum with springs beside it, which a linear test cannot tell


def are_linear_responses(problem: Problem) -> bool:
    """True if all observations are responses of a linear rotor."""
    return all(isinstance(block, Responses) for block in problem.blocks)


def frozen(problem: Problem) -> Problem:
    """The problem with the measured eccentricities taken as given: explicit, without branches and jumps."""
    return replace(problem, blocks=tuple(b.frozen() if isinstance(b, OrbitResponses) else b for b in problem.blocks))


def explicit_with_sense(problem: Problem) -> Problem:
    """The problem with velocity ratios kept positive where only free vibrations were seen: these tell no sense."""
    if not all(isinstance(block, FreeVibrations) for block in problem.blocks):
        return problem
    space = problem.space
    ratio = np.isin([*space.base, *space.nuisance], ("lam", "lam_D", "lam_M"))
    forward = ratio & (space.upper > 0)
    return replace(problem, space=replace(space, lower=np.where(forward, np.maximum(space.lower, 0.0), space.lower)))


def linear_starts(problem: Problem, passes: tuple[int, ...]) -> list[Float]:
    """Starts from closed forms at small eccentricity, with the law at its own start values; empty without any."""
    space = problem.space
    law: Law = getattr(space.model, "law", Constant())
    typical = {q.name: q.scale for q in space.model.parameters}
    begin = law.start(typical.get("K0", 1.0), typical.get("D", 1.0))
    _check_start(law, begin, typical)
    reduced = space.holding({entry: begin[base] for entry, base in enumerate(space.base) if base in begin})
    try:
        candidates = list(dict.fromkeys(closed_forms(reduced, _small_orbits(problem.blocks), passes=passes)))
    except ClosedFormError:
        return []
    return [x for found in candidates for x in _with_law(space, reduced, found.x, law)]


def _check_start(law: Law, begin: Mapping[str, float], typical: Mapping[str, float]) -> None:
    """Refuse a law that is no number where a fit begins, as one that divides by a parameter which starts at zero."""
    values = {name: ca.SX(value) for name, value in {**typical, **begin}.items()}
    found = law.at_speed(SimpleNamespace(**values), ca.SX(_LINEAR_ECCENTRICITY), ca.SX(100.0))
    if not all(np.isfinite(float(ca.evalf(ca.SX(part)))) for part in found):
        said = ", ".join(f"{name} = {value:g}" for name, value in begin.items())
        raise ValueError(
            f"law {law.name} gives no finite K0, D and lam where a fit begins, at {said} and eccentricity "
            f"{_LINEAR_ECCENTRICITY:g}: give its parameters a scale, or the law a start(), at which it does"
        )


def _small_orbits(blocks: tuple[Block, ...]) -> tuple[Block, ...]:
    """Responses at small eccentricity, or, where there are too few, those of the smaller half."""
    chosen: list[Block] = []
    for block in blocks:
        if isinstance(block, Responses):
            chosen.append(block)
        if isinstance(block, OrbitResponses):
            eps = np.where(np.isfinite(block.eccentricity), block.eccentricity, 0.0)
            limit = max(_LINEAR_ECCENTRICITY, float(np.median(eps)))
            chosen.append(block.lines(eps <= limit).base)
        if isinstance(block, OffCentreResponses):
            chosen.append(_as_circular(block))
    return tuple(chosen)


def _as_circular(block: OffCentreResponses) -> Responses:
    """Readings of each probe taken for those of circular orbits: what is anisotropic cancels between x and y."""
    turned = np.where(block.vertical, 1j * block.measured, block.measured)
    turned = np.where(block.frequency[block.line] < 0, np.where(block.vertical, -turned, turned).conj(), turned)
    return Responses(
        model=block.model,
        speed=block.speed,
        frequency=block.frequency,
        force=block.force,
        group=block.group,
        line=block.line,
        coordinate=block.coordinate,
        measured=turned,
        sigma=block.sigma,
        label=block.label,
        labels=block.labels,
        run=block.run,
    )


def _with_law(space: ParameterSpace, reduced: ParameterSpace, x: Float, law: Law) -> Iterator[Float]:
    """Full starts from one of the linear rotor, for several shares of K0 in what stands beside it."""
    linear = dict(zip(reduced.names, x, strict=True))
    bases = dict(zip(reduced.base, x, strict=True))
    scales = {q.name: q.scale for q in space.model.parameters}
    size = [abs(bases[name]) if name in bases else scales.get(name, 1.0) for name in ("K0", "D")]
    begin = law.start(*size)
    for share in _STIFFNESS_SHARES if begin and "K0" in bases else _STIFFNESS_SHARES[:1]:
        yield np.array(
            [
                linear[name] * (share if base == "K0" else 1.0) if name in linear else begin[base]
                for name, base in zip(space.names, space.base, strict=True)
            ]
        )
