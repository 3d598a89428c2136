"""Lumped coefficients of a model's dynamic stiffness: what a linear fit gives, and the parameters that follow.

The dynamic stiffness is linear in sums and products of parameters such as K1 + K2 or D lam. They are read off the
model's graph once for each model and kind of test, and kept: identifying again with other data costs no symbolic work.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.misfit.parameter_space import ParameterSpace
from rotorfit.estimators.starting.lumped_graph import LumpedGraph, lumped_graph
from rotorfit.models import RotorModel
from rotorfit.models.array_types import COLLINEAR, Bool, Float, Index

_NEITHER, _LINEAR, _RECIPROCAL = 0, 1, 2


@dataclass(frozen=True, kw_only=True)
class LumpedStructure:
    """Layout that the lumped coefficients depend on: equal layouts have the same ones."""

    model: RotorModel  # the rotor
    names: tuple[str, ...]  # fitted parameters; this and the next three as in :class:`ParameterSpace`
    base: tuple[str, ...]
    template: tuple[tuple[float, ...], ...]
    index: tuple[tuple[int, ...], ...]
    speeds: tuple[tuple[tuple[int, tuple[float, ...]], ...], ...]

    @classmethod
    def of(cls, space: ParameterSpace, blocks: Sequence[Responses]) -> LumpedStructure:
        """LumpedStructure of a fit to these blocks."""
        speeds = []
        for block in blocks:
            pairs: dict[int, list[float]] = {}
            for group, speed in zip(*(column.tolist() for column in block.condition[1:]), strict=True):
                pairs.setdefault(group, []).append(speed)
            speeds.append(tuple((group, tuple(own)) for group, own in pairs.items()))
        return cls(
            model=space.model,
            names=space.names,
            base=space.base,
            template=tuple(map(tuple, space.template.tolist())),
            index=tuple(map(tuple, space.index.tolist())),
            speeds=tuple(speeds),
        )


class Lumped:
    """Lumped coefficients as functions of the fitted vector."""

    def __init__(self, graph: LumpedGraph, speeds: Sequence[float], known: tuple[float, ...], scale: Float) -> None:
        given = np.array([*speeds, np.nan])  # the last one is that of all speeds
        self.place = replace(graph.place, speed=given[graph.place.speed.astype(np.intp)])
        self.size = scale.size
        self._function, self._speeds, self._known = graph.function, list[Any](speeds), known
        self._rows, self._columns = graph.rows, graph.columns
        self._kind = self._dependence(scale)
        count = self.place.row.size
        self.basis, self.spread, self.offset = _independent(self, scale)
        if self.basis.size == count:  # to the last digit
            self.spread, self.offset = np.eye(count), np.zeros(count)
        self.back = self.spread if self.basis.size == count else np.linalg.pinv(self.spread)
        self.determined: dict[int, bool] = {}  # whether tests give all of them, by a digest of their layout
        self._singles: dict[bytes, list[_Single]] = {}

    def _evaluate(self, x: Float) -> tuple[Float, Float]:
        """Coefficients and their nonzero derivatives, shape ``(E, ...)`` for vectors of shape ``(p, ...)``."""
        found = self._function([*(x.tolist() if x.ndim == 1 else x), *self._speeds, *self._known])
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

    def _dependence(self, scale: Float) -> Index:
        """How each coefficient depends on each parameter in it: linear, linear in its reciprocal, or neither."""
        rng = np.random.default_rng(2)
        here, there = (scale * np.exp(rng.uniform(-1, 1, scale.size)) for _ in range(2))
        slopes, others = self._evaluate(here)[1], self._evaluate(there)[1]
        kind = np.where(np.isclose(slopes, others, rtol=1e-9, atol=0), _LINEAR, _NEITHER)
        for i in np.unique(self._columns[kind == _NEITHER]):
            mine = np.flatnonzero(self._columns == i)
            linear = reciprocal = np.ones(mine.size, dtype=bool)
            for factor in (0.7, 1.9, 31.0):
                moved = here.copy()
                moved[i] *= factor
                slope = self._evaluate(moved)[1][mine]
                linear = linear & np.isclose(slope, slopes[mine], rtol=1e-9, atol=0)
                reciprocal = reciprocal & np.isclose(slope * factor**2, slopes[mine], rtol=1e-9, atol=0)
            kind[mine] = np.where(linear, _LINEAR, np.where(reciprocal, _RECIPROCAL, _NEITHER))
        return np.asarray(kind, dtype=np.intp)

    def parameters(self, values: Float, typical: Float) -> Float:
        """Solve the coefficients for the parameters one after the other. Each comes from a coefficient in which it is
        the only unknown, first those that depend on it most. Returns parameters, NaN where no coefficient gives one
        singly, shape ``(p,)``."""
        point, unknown = typical.copy(), np.ones(self.size, dtype=bool)
        with np.errstate(divide="ignore"):
            while unknown.any() and np.isfinite(point).all():
                now, slopes = self._evaluate(point)
                own = [single for single in self._alone(unknown) if slopes[single.derivative]]
                if not own:
                    break
                solved, share = np.array([single.solve(now, slopes, values, point) for single in own]).T
                # Backwards, so that of several equally good coefficients the first one counts.
                for i in np.flatnonzero(share >= (1 - 1e-12) * np.nanmax(share))[::-1].tolist():
                    point[own[i].column], unknown[own[i].column] = solved[i], False
        return np.where(unknown, np.nan, point)

    def _alone(self, unknown: Bool) -> list[_Single]:
        """Derivatives of coefficients by what is the only unknown in them, and can be solved for."""
        key = unknown.tobytes()
        if key not in self._singles:
            count = np.bincount(self._rows[unknown[self._columns]], minlength=self.place.row.size)
            alone = unknown[self._columns] & (count[self._rows] == 1) & (self._kind != _NEITHER)
            self._singles[key] = [
                _Single(int(place), int(self._rows[place]), int(self._columns[place]), self._kind[place] == _RECIPROCAL)
                for place in np.flatnonzero(alone)
            ]
        return self._singles[key]


class _Single(NamedTuple):
    """A coefficient in which one parameter is the only unknown."""

    derivative: int  # number of the derivative of the one by the other
    row: int  # number of the coefficient
    column: int  # number of the parameter
    reciprocal: bool  # linear in one over the parameter, not in the parameter

    def solve(self, now: Float, slopes: Float, values: Float, point: Float) -> tuple[float, float]:
        """The parameter by one coefficient, and the share of the coefficient that depends on it."""
        here, level, slope = point[self.column], now[self.row], slopes[self.derivative]
        # The coefficient is rest + slope t, with t the parameter or its reciprocal.
        if self.reciprocal:
            slope = -slope * here**2
            rest = level - slope / here
        else:
            rest = level - slope * here
        rest = rest * (abs(rest) >= 1e-13 * abs(level))
        own = values[self.row] - rest
        solved = slope / own if self.reciprocal else own / slope
        return solved, abs(own) / (abs(rest) + abs(own) + 1e-300)


@lru_cache(maxsize=32)
def lumped_coefficients(layout: LumpedStructure) -> Lumped:
    """Lumped coefficients of a model in some blocks of observations."""
    speeds = [speed for groups in layout.speeds for _, own in groups for speed in own]
    kinds = tuple(tuple((group, len(own), any(own)) for group, own in groups) for groups in layout.speeds)
    scale = np.array([layout.model.parameter(name).scale for name in layout.base])
    rows = zip(layout.index, layout.template, strict=True)
    given = [[0.0 if k >= 0 else value for k, value in zip(*row, strict=True)] for row in rows]
    vanishing = (-1.0, 0.0, 1.0)  # known values with which terms of the equation of motion vanish
    form = tuple(tuple(value if value in vanishing else None for value in row) for row in given)
    known = tuple(value for row in given for value in row if value not in vanishing)
    return Lumped(lumped_graph(layout.model, form, layout.index, kinds, len(layout.names)), speeds, known, scale)


def _independent(lumped: Lumped, scale: Float) -> tuple[Index, Float, Float]:
    """Write every lumped coefficient as an affine function of independent ones. Relations such as kappa_12 = -K2 =
    kappa_21 are found by evaluating the coefficients at random parameters. Returns rows of independent coefficients
    ``b``; matrix ``S`` and offset ``o`` with ``all = S b + o``."""
    count, size = lumped.place.row.size, scale.size
    rng = np.random.default_rng(0)
    samples = scale * np.exp(rng.uniform(-1, 1, (2 * min(count, 4 * size) + 4 * size + 8, size)))
    if count <= size:
        # Affine relations are relations between gradients: with independent gradients there are none.
        slopes = lumped.linearise(samples[0])[1] * samples[0]
        norm = np.linalg.norm(slopes, axis=1)
        if norm.all() and np.linalg.svd(slopes / norm[:, None], compute_uv=False)[-1] > COLLINEAR:
            return np.arange(count), np.eye(count), np.zeros(count)
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
