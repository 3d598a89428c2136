"""Lumped coefficients of a model's dynamic stiffness: what a linear fit gives, and the parameters that follow.

The dynamic stiffness is linear in sums and products of parameters such as K1 + K2 or D lam. They are read off the
model's graph once for each model and kind of test, and kept: identifying again with other data costs no symbolic work.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import COLLINEAR, ComplexArray, Float, Index
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.misfit.parameter_space import ParameterSpace
from rotorfit.models import RotorModel
from rotorfit.models.compiled import array_function

_NEITHER, _LINEAR, _RECIPROCAL = 0, 1, 2


class Lumped:
    """Lumped coefficients as functions of the fitted vector."""

    def __init__(self, graph: LumpedGraph, given: tuple[float, ...], scale: Float, kind: Index) -> None:
        # The speeds come first, the number -1 is that of the NaN behind all.
        self.place = graph._replace(speed=np.array([*given, np.nan])[graph.speed])
        self.size, self._given = scale.size, given
        self._rows, self._columns = graph.of_coefficient, graph.by_value
        self._kind = kind  # how each coefficient depends on each parameter in it
        count = self.place.row.size
        self.basis, self.spread, self.offset = _independent(self, scale)
        if self.basis.size == count:  # to the last digit
            self.spread, self.offset = np.eye(count), np.zeros(count)
        self.back = self.spread if self.basis.size == count else np.linalg.pinv(self.spread)
        self.determined: dict[int, bool] = {}  # whether tests give all of them, by a digest of their layout

    def _evaluate(self, x: Float) -> tuple[Float, Float]:
        """Coefficients and their nonzero derivatives, shape ``(E, ...)`` for vectors of shape ``(p, ...)``."""
        with np.errstate(divide="ignore", invalid="ignore"):  # a factor of a probe may be at its limit, zero
            found = self.place.function([*x, *self._given])
        return found[: self.place.row.size], found[self.place.row.size :]

    def values(self, x: Float) -> Float:
        """Lumped coefficients, shape ``(E, ...)``."""
        return self._evaluate(x)[0]

    def linearise(self, x: Float) -> tuple[Float, Float]:
        """Coefficients and their derivatives at one vector, shapes ``(E,)`` and ``(E, p)``."""
        values, slopes = self._evaluate(x)
        jacobian = np.zeros((len(values), self.size))
        jacobian[self._rows, self._columns] = slopes
        return values, jacobian

    def parameters(self, values: Float, typical: Float) -> Float:
        """Solve the coefficients for the parameters one after the other. Each comes from a coefficient in which it is
        the only unknown, first those that depend on it most. Returns parameters, NaN where no coefficient gives one
        singly, shape ``(p,)``."""
        point, unknown = typical.copy(), np.ones(self.size, dtype=bool)
        with np.errstate(divide="ignore", invalid="ignore"):
            while unknown.any() and np.isfinite(point).all():
                now, slopes = self._evaluate(point)
                # Derivatives by what is the only unknown in a coefficient, and solvable.
                among = unknown[self._columns]
                count = np.bincount(self._rows[among], minlength=self.place.row.size)
                alone = np.flatnonzero(among & (count[self._rows] == 1) & (self._kind != _NEITHER) & (slopes != 0))
                if not alone.size:
                    break
                row, column, reciprocal = self._rows[alone], self._columns[alone], self._kind[alone] == _RECIPROCAL
                here, level = point[column], now[row]
                # Each coefficient is rest + slope t, with t the parameter or its reciprocal.
                slope = np.where(reciprocal, -slopes[alone] * here**2, slopes[alone])
                rest = level - np.where(reciprocal, slope / here, slope * here)
                rest *= np.abs(rest) >= 1e-13 * np.abs(level)
                own = values[row] - rest
                solved = np.where(reciprocal, slope / own, own / slope)
                share = np.abs(own) / (np.abs(rest) + np.abs(own) + 1e-300)
                # Backwards, so that of several equally good coefficients the first one counts.
                for i in np.flatnonzero(share >= (1 - 1e-12) * np.nanmax(share))[::-1].tolist():
                    point[column[i]], unknown[column[i]] = solved[i], False
        return np.where(unknown, np.nan, point)


def lumped_coefficients(space: ParameterSpace, blocks: Sequence[Responses]) -> Lumped:
    """Lumped coefficients of a model in some blocks of observations; kept, and the same ones for tests that differ in
    nothing that they depend on, as in speeds where they are polynomials of the speed."""
    kinds, speeds = [], []
    for block in blocks:
        _, groups, tested = block.condition
        own = {group: tested[groups == group].tolist() for group in dict.fromkeys(groups.tolist())}
        kinds.append(tuple((group, len(some), any(some)) for group, some in own.items()))
        speeds += [speed for some in own.values() for speed in some]
    given = np.where(space.index >= 0, 0.0, space.template).tolist()
    vanishing = (-1.0, 0.0, 1.0)  # known values with which terms of the equation of motion vanish
    form = tuple(tuple(value if value in vanishing else None for value in row) for row in given)
    known = tuple(value for row in given for value in row if value not in vanishing)
    layout = (space.model, form, tuple(map(tuple, space.index.tolist())), tuple(kinds), len(space.names))
    if (lumped_graph(*layout).speed < 0).all():  # none of them holds at one speed only
        speeds = [0.0] * len(speeds)
    return _lumped(layout, tuple(speeds), known, tuple(space.typical.tolist()))


@lru_cache(maxsize=32)
def _lumped(
    layout: tuple[Any, ...], speeds: tuple[float, ...], known: tuple[float, ...], scale: tuple[float, ...]
) -> Lumped:
    kind = _dependence(layout, len(speeds), known, scale)
    return Lumped(lumped_graph(*layout), (*speeds, *known), np.array(scale), kind)


@lru_cache(maxsize=32)
def _dependence(layout: tuple[Any, ...], speeds: int, known: tuple[float, ...], scale: tuple[float, ...]) -> Index:
    """How each coefficient depends on each parameter in it, at any speeds: linear, linear in its reciprocal, or
    neither."""
    graph, size = lumped_graph(*layout), len(scale)
    given = (*(100.0 * (number + 1) for number in range(speeds)), *known)
    here = np.array(scale) * np.exp(np.random.default_rng(2).uniform(-1, 1, size))
    factors = np.array([0.7, 1.9, 31.0])
    moved = here[:, None, None] * np.where(np.eye(size)[:, :, None], factors, 1.0)  # each by itself
    slopes, moved_slopes = (graph.function([*x, *given])[graph.row.size :] for x in (here.tolist(), moved))
    own = moved_slopes[np.arange(graph.by_value.size), graph.by_value]
    linear = np.isclose(own, slopes[:, None], rtol=1e-9, atol=0).all(axis=1)
    reciprocal = np.isclose(own * factors**2, slopes[:, None], rtol=1e-9, atol=0).all(axis=1)
    return np.where(linear, _LINEAR, np.where(reciprocal, _RECIPROCAL, _NEITHER))


def _independent(lumped: Lumped, scale: Float) -> tuple[Index, Float, Float]:
    """Write every lumped coefficient as an affine function of independent ones. Relations such as kappa_12 = -K2 =
    kappa_21 are found by evaluating the coefficients at random parameters. Returns rows of independent coefficients
    ``b``; matrix ``S`` and offset ``o`` with ``all = S b + o``."""
    count, size = lumped.place.row.size, scale.size
    rng = np.random.default_rng(0)
    samples = scale * np.exp(rng.uniform(-1, 1, (2 * min(count, 4 * size) + 4 * size + 8, size)))
    values = np.ascontiguousarray(lumped.values(samples.T).T)
    centre = values.mean(axis=0)
    spread = values - centre
    norm = np.linalg.norm(spread, axis=0)
    moving = norm > 1e-12 * np.linalg.norm(values, axis=0)
    scaled = np.where(moving, spread / np.where(moving, norm, 1.0), 0.0)
    basis = _basis(scaled, np.flatnonzero(moving))
    S = np.linalg.lstsq(spread[:, basis], spread, rcond=None)[0].T
    S[np.abs(S) < 1e-11 * np.abs(S).max(axis=1, keepdims=True, initial=1e-300)] = 0.0
    return basis, S, centre - S @ centre[basis]


def _basis(columns: Float, moving: Index) -> Index:
    """Columns that make all of them: one of those that are parallel, mostly, else by pivoted QR."""
    cosine = np.abs(columns[:, moving].T @ columns[:, moving])
    rounding = 1e-12  # one less the cosine of columns that say the same
    apart = moving[(cosine > 1 - rounding).argmax(axis=0) == np.arange(moving.size)]
    if 0 < apart.size <= len(columns) and np.linalg.svd(columns[:, apart], compute_uv=False)[-1] > COLLINEAR:
        return np.asarray(apart, dtype=np.intp)
    from scipy.linalg import qr  # late: loading it takes longer than a fit

    r, pivots = qr(columns, mode="r", pivoting=True)
    diagonal = np.abs(np.diag(r))
    rank = int(np.sum(diagonal > COLLINEAR * diagonal[0])) if diagonal.size else 0
    return np.asarray(np.sort(pivots[:rank]), dtype=np.intp)


class LumpedGraph(NamedTuple):
    """Lumped coefficients with speeds and known values as variables, and where they enter the dynamic stiffness, one
    entry a coefficient, shape ``(E,)``: fits that differ in those variables share one."""

    block: Index
    group: Index
    row: Index  # row of kappa of each entry
    column: Index  # column of kappa of each entry
    power: Index  # power of s
    unit: ComplexArray  # 1 or j
    speed_power: Index  # power of the rotative speed
    speed: NDArray[Any]  # number of the speed to which it is restricted, -1 for all; in :class:`Lumped` itself, or NaN
    function: Callable[[Sequence[Any]], Float]
    of_coefficient: Index  # coefficient of each derivative
    by_value: Index  # fitted value of each derivative


@lru_cache(maxsize=32)
def lumped_graph(
    model: RotorModel,
    template: tuple[tuple[float | None, ...], ...],
    index: tuple[tuple[int, ...], ...],
    kinds: tuple[tuple[tuple[int, int, bool], ...], ...],
    size: int,
) -> LumpedGraph:
    """Expressions of the lumped coefficients of a model in some blocks of observations."""
    x = ca.SX.sym("x", size)
    speed = ca.SX.sym("speed")
    speeds = ca.SX.sym("speeds", sum(count for groups in kinds for _, count, _ in groups))
    known = ca.SX.sym("known", sum(value is None for row in template for value in row))
    symbols = iter(range(known.numel()))
    thetas = [[known[next(symbols)] if value is None else value for value in row] for row in template]
    places: list[tuple[float | complex, ...]] = []
    expressions: list[ca.SX] = []
    first = 0
    for block, groups in enumerate(kinds):
        for group, count, turns in groups:
            theta = [x[k] if k >= 0 else value for k, value in zip(index[group], thetas[group], strict=True)]
            own = [(first + k, speeds[first + k]) for k in range(count)]
            for *entry, expression in _entries(model, theta, speed):
                for degree, at, part in _speed_parts(expression, speed, own, turns):
                    places.append((block, group, *entry, degree, at))
                    expressions.append(part)
            first += count
    values = ca.vertcat(*expressions)
    jacobian = ca.jacobian(values, x)
    rows, columns = (np.asarray(part, dtype=np.intp) for part in jacobian.sparsity().get_triplet())
    # As an array function: calls of CasADi's own spend most of their time on converting matrices.
    function = array_function(ca.Function("lumped", [x, speeds, known], [ca.densify(values), jacobian]))
    return LumpedGraph._make([*map(np.array, zip(*places, strict=True)), function, rows, columns])


def _entries(
    model: RotorModel, theta: Sequence[ca.SX | float], speed: ca.SX
) -> Iterator[tuple[int, int, int, complex, ca.SX]]:
    """Row, column, power of s, unit and expression of what is not zero in a centred rotor, probes' factors left out."""
    n = len(model.coordinates)
    inputs = ca.vertcat(*theta, speed, 0.0)
    flat = model.functions.graph(inputs)
    factors = model.functions.factor_graph(inputs)
    for number in range(flat.numel()):
        power, rest = divmod(number, 2 * n * n)
        imaginary, place = divmod(rest, n * n)
        row, column = divmod(place, n)
        if not flat[number].is_zero():
            seen = ca.simplify(flat[number] / factors[2 * column])
            yield row, column, power, 1j if imaginary else 1.0 + 0j, seen


def _speed_parts(
    expression: ca.SX, speed: ca.SX, speeds: Sequence[tuple[int, ca.SX]], turns: bool
) -> list[tuple[int, int, ca.SX]]:
    """Split a coefficient by powers of the speed, or by speed where too few speeds were tested for that. Returns the
    power of the speed, running number of the speed or -1 for all, and expression of each part."""
    if not turns:  # a rotor at rest: terms with the speed say nothing
        expression = ca.simplify(ca.substitute(expression, speed, ca.SX(0.0)))
    if not ca.depends_on(expression, speed):
        return [] if expression.is_zero() else [(0, -1, expression)]
    parts, derivative, factorial = [], expression, 1.0
    speed_terms = 5  # powers of the speed looked for in a coefficient
    for degree in range(speed_terms):
        part = ca.simplify(ca.substitute(derivative, speed, ca.SX(0.0)) / factorial)
        if not part.is_zero():
            parts.append((degree, -1, part))
        derivative = ca.simplify(ca.jacobian(derivative, speed))
        factorial *= degree + 1
        if derivative.is_zero() or not derivative.nnz():
            if len(parts) <= len(speeds):
                return parts
            break
    return [(0, number, ca.substitute(expression, speed, own)) for number, own in speeds]
