"""Closed-form identification: matrix inversion (eqs 5 to 9) and straight lines, no iteration and no starting values.

The dynamic stiffness is linear in its lumped coefficients (sums and products of parameters, such as K1 + K2 or D lam).
One linear least-squares problem gives those, and the parameters follow from them one after the other, each from an
equation in which it is the only unknown. Both steps are read off the model's own graph, so they exist for every model.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.estimators.blocks.observations import Block, Responses, linear_responses
from rotorfit.estimators.blocks.response import dynamic_stiffness, inverse
from rotorfit.estimators.misfit.parameter_space import ParameterSpace
from rotorfit.estimators.misfit.problem import READINGS_OF_A_PIECE
from rotorfit.estimators.noise.run_effects import inverse_of_determined
from rotorfit.estimators.starting.force_balance import (
    ForceBalance,
    complete_lines,
    one_by_one,
    products,
    solve,
    solve_definite,
    solve_projected,
    weigh,
)
from rotorfit.estimators.starting.lumped import Lumped, lumped_coefficients


@dataclass(frozen=True, eq=False)
class ClosedForm:
    """A closed-form estimate."""

    x: Float  # estimate, shape ``(p,)``
    root: tuple[Float, Float] | None
    open: tuple[int, ...] = ()  # entries that were taken at their conventional value
    notes: tuple[str, ...] = ()  # what had to be assumed, in words

    @property
    def covar(self) -> Float:
        """Covariance from the propagated noise, shape ``(p, p)``, NaN where unweighted."""
        found = np.full((self.x.size - len(self.open),) * 2, np.nan)
        if self.root is not None:
            jacobian, information = self.root  # of the lumped coefficients, and on them
            found, _ = inverse_of_determined(jacobian.T @ information @ jacobian, 1e-15)
        for entry in self.open:
            found = np.insert(np.insert(found, entry, 0.0, axis=0), entry, 0.0, axis=1)
        return found


class ClosedFormError(ValueError):
    """The data do not allow a closed form; the message says what is missing."""


def closed_form(
    space: ParameterSpace, blocks: tuple[Block, ...], *, weighted: bool = True, passes: int = 2
) -> ClosedForm:
    """Identify without iteration.

    Weighted, three linear solves: the bare force balance; the same weighed with the noise that its result propagates;
    once more with the responses of that result as instruments, because the noise of the measured responses, which stand
    among the regressors, would otherwise pull the stiffness towards zero.
    """
    return next(closed_forms(space, blocks, weighted=weighted, passes=(passes,)))


def closed_forms(
    space: ParameterSpace, blocks: tuple[Block, ...], *, weighted: bool = True, passes: tuple[int, ...]
) -> Iterator[ClosedForm]:
    """Closed forms after several numbers of passes, ascending, up to where they settle; see :func:`closed_form`. They
    are of set speeds: speeds that wander are too near to one another to tell what changes with speed."""
    steady = tuple(block.at_set_speed() for block in blocks)
    if any(own is not block for own, block in zip(steady, blocks, strict=True)):
        rough = next(_closed_forms(space, steady, weighted, (min(passes),)))
        theta = space.theta(np.append(rough.x, np.zeros(len(space.nuisance))))
        found: list[Block] = []  # with the readings that a rotor of about the same values would have given there
        for block, own in zip(blocks, steady, strict=True):
            if own is block:
                found.append(own)
                continue
            here = block.predict(theta)
            factor = np.divide(own.predict(theta), here, out=np.ones_like(here), where=here != 0)
            found.append(own.with_measured(block.measured * factor))
        steady = tuple(found)
    yield from _closed_forms(space, steady, weighted, passes)


def _closed_forms(
    space: ParameterSpace, blocks: tuple[Block, ...], weighted: bool, passes: tuple[int, ...]
) -> Iterator[ClosedForm]:
    chosen = [complete_lines(block) for block in linear_responses(blocks)]
    chosen = [block for block in chosen if block.speed.size]
    if not chosen:
        raise ClosedFormError(
            "the closed form needs responses to a circular force with readings at every plane of the model; "
            "give start values instead"
        )
    lumped = lumped_coefficients(space, chosen)
    if not _determined(space, lumped, chosen):
        yield from _with_convention(space, blocks, weighted, passes)
        return
    typical = space.template
    if space.model.shaft is not None:  # whose scale factors are not linear here
        typical = space.theta(np.concatenate([typical_values(space), np.zeros(len(space.nuisance))]))
    if weighted:
        yield from _weighted(space, lumped, chosen, typical, passes)
        return
    equations = [ForceBalance(lumped, number, block, typical) for number, block in enumerate(chosen)]
    solution, _ = solve(lambda: (e.stiffness_balance() for e in equations))
    x, notes = parameters_from(space, lumped, lumped.offset + lumped.spread @ solution, None)
    yield ClosedForm(x, None, notes=notes)


def _weighted(
    space: ParameterSpace, lumped: Lumped, blocks: list[Responses], typical: Float, passes: tuple[int, ...]
) -> Iterator[ClosedForm]:
    solutions = _passes(lumped, blocks, typical)
    before = np.zeros(0)
    tolerance = 1e-6  # relative change of the lumped coefficients after which further passes bring nothing
    for number in range(1, passes[-1] + 1):
        try:
            solution, information = next(solutions)
        except np.linalg.LinAlgError as reason:
            if number > passes[0]:
                return  # further passes diverge; those before are near enough to start from
            raise ClosedFormError("the passes diverge: the noise hides a response") from reason
        settled = number > 1 and bool(np.all(np.abs(solution - before) <= tolerance * np.abs(solution)))
        before = solution
        if settled or number in passes:
            x, notes = parameters_from(space, lumped, lumped.offset + lumped.spread @ solution, information)
            yield ClosedForm(x, (lumped.linearise(x)[1][lumped.basis], information), notes=notes)
        if settled:
            return


def _passes(lumped: Lumped, blocks: list[Responses], typical: Float) -> Iterator[tuple[Float, Float]]:
    """Independent lumped coefficients and the information on them after one weighted pass, after two, and so on."""
    pieces = [(number, piece) for number, block in enumerate(blocks) for piece in block.split(READINGS_OF_A_PIECE)]
    equations = [ForceBalance(lumped, *piece, typical) for piece in pieces]

    def weight_of(e: ForceBalance) -> tuple[ComplexArray, ComplexArray]:
        H = e.receptance(solution)
        return H, e.response_weight(H)

    solution, _ = solve(lambda: (weigh(e.sides(), e.force_weight()) for e in equations))
    solution, information = solve(lambda: (weigh(e.sides(), weight_of(e)[1]) for e in equations))
    while True:
        yield solution, information
        size = solution.size
        projected, information = np.zeros((size, size + 1)), np.zeros((size, size))
        for e in equations:
            H, weight = weight_of(e)
            instruments = e.sensitivities(e.predicted(H), weight)
            projected += products(instruments, weigh(e.sides(), weight))
            information += products(instruments, instruments)
        solution = solve_projected(projected, information)


def _determined(space: ParameterSpace, lumped: Lumped, blocks: list[Responses]) -> bool:
    """True if such a test can give all independent lumped coefficients, judged on exact responses of a typical rotor.
    Noise hides the defect: the force balance of a plane that is never forced is homogeneous, and noisy data "solve" it
    with zeros."""
    key = 0
    for b in blocks:
        where = b.coordinate if b.imposed else np.round(b.force.T / np.abs(b.force.T).max(axis=0), 6)
        speed = np.round(b.speed / (np.abs(b.speed).max() or 1.0), 3)
        for part in (b.condition[0], speed, b.frequency, where):
            key = crc32(np.ascontiguousarray(part).data, key)
    if key in lumped.determined:
        return lumped.determined[key]
    rng = np.random.default_rng(1)
    x = typical_values(space) * rng.uniform(0.8, 1.25, len(space.names))
    theta = space.theta(np.concatenate([x, np.zeros(len(space.nuisance))]))
    designs = []
    for number, block in enumerate(blocks):
        equations = ForceBalance(lumped, number, block, theta)
        H = inverse(dynamic_stiffness(block, theta))
        amplitude = equations.predicted(H)
        weight = H / np.abs(amplitude).max(axis=1)[:, None, None]
        designs.append(one_by_one(equations.sensitivities(amplitude, weight)))
    design = np.concatenate(designs, axis=1)
    norm = np.linalg.norm(design, axis=1, keepdims=True)
    power = np.linalg.svd(design / np.where(norm > 0, norm, 1.0), compute_uv=False)
    lumped.determined[key] = bool(norm.all() and power[-1] > 1e-9 * power[0])
    return lumped.determined[key]


def _with_convention(
    space: ParameterSpace, blocks: tuple[Block, ...], weighted: bool, passes: tuple[int, ...]
) -> Iterator[ClosedForm]:
    """Closed form with one more parameter at its conventional value, where the data leave a combination open."""
    nominals = [(i, space.model.parameter(base).nominal) for i, base in enumerate(space.base)]
    entry, nominal = next((pair for pair in nominals if pair[1] is not None), (-1, None))
    if nominal is None:
        raise ClosedFormError(
            "these data do not determine the lumped coefficients of the model: fix parameters or give start values"
        )
    note = f"{space.names[entry]} taken as {nominal:g}: these data leave it open"
    for found in _closed_forms(space.holding({entry: nominal}), blocks, weighted, passes):
        x = np.insert(found.x, entry, nominal)
        yield replace(found, x=x, open=(*found.open, entry), notes=(note, *found.notes))


def parameters_from(
    space: ParameterSpace, lumped: Lumped, values: Float, information: Float | None
) -> tuple[Float, tuple[str, ...]]:
    """Solve the lumped expressions for the parameters, one unknown at a time, then take one weighted step on all."""
    size = len(space.names)
    x = lumped.parameters(values, typical_values(space))
    notes: tuple[str, ...] = ()
    if np.isnan(x).any():
        x, notes = _solved_together(space, lumped, values, x)
    if information is not None:
        x = _one_step(lumped, values, information, x)
    inside = np.clip(x, space.lower[:size], space.upper[:size])
    if information is not None and np.isfinite(x).all():
        inside = _beside_bounds(space, lumped, values, information, inside, held=inside != x)
    return np.where(np.isfinite(inside), inside, np.nan), notes


def _solved_together(space: ParameterSpace, lumped: Lumped, values: Float, x: Float) -> tuple[Float, tuple[str, ...]]:
    """Parameters that no single coefficient gives, from all of them together; a typical value where none depends on
    one."""
    from scipy.optimize import least_squares

    missing = np.flatnonzero(np.isnan(x))
    typical = typical_values(space)[missing]

    def at(u: Float) -> Float:
        y = x.copy()
        y[missing] = u * typical
        return y

    ones = np.ones(missing.size)
    level = np.maximum(np.abs(values), np.abs(lumped.values(at(ones))))
    weight = 1.0 / np.where(level > 0, level, 1.0)
    solved = least_squares(lambda u: (lumped.values(at(u)) - values) * weight, ones, x_scale="jac", max_nfev=50)
    seen = solved.jac.any(axis=0).tolist()
    silent = ", ".join(space.names[i] for i, own in zip(missing.tolist(), seen, strict=True) if not own)
    note = f"{silent}: no coefficient depends on it; a typical value is taken"
    return at(solved.x), (note,) if silent else ()


def typical_values(space: ParameterSpace) -> Float:
    """Nonzero sizes of the free parameters, shape ``(p,)``."""
    parameters = [space.model.parameter(name) for name in space.base]
    size = len(parameters)
    guess = np.array([p.scale if p.nominal is None else p.nominal for p in parameters])
    inside = np.clip(guess, space.lower[:size], space.upper[:size])
    return np.where(inside == 0, 1e-3, inside)


@np.errstate(invalid="ignore")  # a probe that reads nothing, at the limit of its factor, tells nothing
def _beside_bounds(
    space: ParameterSpace, lumped: Lumped, values: Float, information: Float, x: Float, *, held: Bool
) -> Float:
    """The other parameters solved again where some are ``held`` at a bound that they had crossed: a mass that shares a
    sum with another takes its part of it along."""
    size = x.size

    def miss(y: Float) -> Float:
        return np.asarray(lumped.back @ (values - lumped.linearise(y)[0]))

    for _ in range(5 if held.any() and not held.all() else 0):
        J = (lumped.back @ lumped.linearise(x)[1])[:, ~held]
        if not np.isfinite(J).all():
            break
        root = np.sqrt(np.maximum(np.einsum("ij,ik,kj->j", J, information, J), 1e-300))
        unit, right = (J / root).T @ information @ (J / root), (J / root).T @ information @ miss(x)
        other = x.copy()
        other[~held] += np.linalg.lstsq(unit, right, rcond=1e-10)[0] / root
        other = np.clip(other, space.lower[:size], space.upper[:size])
        if not miss(other) @ information @ miss(other) < miss(x) @ information @ miss(x):
            break
        x = other
    return x


def _one_step(lumped: Lumped, values: Float, information: Float, x: Float) -> Float:
    """One linearised weighted step on all lumped coefficients at once: it uses the redundant ones as well."""
    now, jacobian = lumped.linearise(x)
    # information is that of the independent coefficients b, all = S b + o: least squares on S(b_model - b) = 0
    J = lumped.back @ jacobian
    normal = J.T @ information @ J
    root = np.sqrt(np.maximum(normal.diagonal(), 1e-300))
    right = J.T @ information @ (lumped.back @ (values - now)) / root
    unit = normal / np.outer(root, root)
    step = solve_definite(unit, right)
    if step is None:
        step = np.linalg.lstsq(unit, right, rcond=1e-10)[0]
    moved = x + step / root
    # The linearisation holds near the solution only; a step that changes a parameter beyond its size is not taken.
    return moved if (np.abs(moved - x) <= 0.5 * np.abs(x) + 1e-300).all() else x
