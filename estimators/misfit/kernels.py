"""The misfit of many parameter vectors at once: compiled where that pays, else as the problem itself evaluates them.

Readings are sorted so that one inverse of the dynamic stiffness serves all of a condition and line.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index
from rotorfit.estimators.blocks.row_keys import combined, numbers, occurrence
from rotorfit.estimators.misfit import accelerator, codegen
from rotorfit.estimators.misfit.codegen import LARGEST_UNROLLED
from rotorfit.estimators.misfit.problem import Problem, linear_response

READINGS_OF_A_NODE = 8
"""Readings evaluated together at a node where code is generated; more are split, so that it stays short."""


@dataclass(frozen=True, eq=False, kw_only=True)
class KernelLayout:
    """Plain arrays of all responses of a problem. A *node* is one dynamic stiffness matrix: a condition (parameter
    group and rotative speed) at one frequency. Nodes that were read in the same way form a *segment*; the readings of a
    segment form *entries*, each with one datum a node."""

    group: Index  # of each condition, shape ``(C,)``
    speed: Float  # of each condition, shape ``(C,)``
    frequency: Float  # variable w of ``s = j w`` at each node, shape ``(N,)``
    # rows of first node, past the last node, condition, first entry, past the last entry, shape ``(S, 5)``
    segments: Index
    coordinate: Index  # of each entry
    direction: Index  # of each entry
    gain: Index  # of each entry
    channel: Index  # of each entry
    datum: Index  # of each entry
    directions: ComplexArray  # force directions, largest component one, shape ``(U, n)``
    nuisance: ComplexArray  # of each distinct gain
    gain_group: Index  # of each distinct gain
    gain_coordinate: Index  # of each distinct gain
    reading: Index  # reading (in the order of the blocks) behind each datum, shape ``(Q,)``
    # force component that the direction is normalised by, one where there is no force, shape ``(Q,)``
    drive: ComplexArray
    sigma: Float  # standard deviation of each reading, shape ``(Q,)``
    measured: ComplexArray  # complex readings, shape ``(Q,)``

    @cached_property
    def weight(self) -> Float:
        """Square of force over sigma at each datum, shape ``(Q,)``."""
        return np.asarray(np.abs(self.drive) ** 2 / self.sigma**2)

    @cached_property
    def target(self) -> ComplexArray:
        """Measured response to a unit force at each datum, shape ``(Q,)``."""
        return self.measured / self.drive


def _distinct(rows: Float | Index) -> tuple[Index, Index]:
    """First place of each distinct row, ascending, and each row's number."""
    _, first, number = np.unique(combined(*map(numbers, rows.T)), return_index=True, return_inverse=True)
    return first, number.reshape(-1)


def layout(problem: Problem) -> KernelLayout:
    """Sort the readings of a problem, all of them responses to forces, in the order of the kernels.

    Readings x at the frequencies 1, 2, 3 and y at 1 and 3 become two segments::

        node       1   2   3        segment 0: nodes 1, 3, entries x, y: data x1 x3 y1 y3
        read as    xy  x   xy       segment 1: node 2,     entry x:      datum x2
    """
    parts: list[tuple[NDArray[Any], ...]] = []
    for i, block in enumerate(problem.blocks):
        base = block.linear
        if base is None or base is not block:
            raise TypeError(f"{type(block).__name__} are no responses to forces")
        line = base.line
        speed = base.speed if base.model.speed_dependent else np.zeros_like(base.speed)
        factors = problem.factors[i] if problem.factors else None
        nuisance = np.zeros((line.size, len(problem.space.nuisance)), dtype=complex) if factors is None else factors
        own = (base.group[line], speed[line], base.s[line].imag, base.coordinate, base.force[line])
        parts.append((*own, nuisance, base.sigma, base.measured))
    group, speed, w, coordinate, force, nuisance, sigma, measured = map(np.concatenate, zip(*parts, strict=True))
    channel, size = problem.channel, len(problem.space.model.coordinates)
    # Distinct force directions, real and imaginary parts in turn, and the largest component of each reading's.
    drive = force[np.arange(len(force)), np.argmax(np.abs(force), axis=1)]
    drive = np.where(drive == 0, 1.0, drive)
    unit = np.round((force / drive[:, None]).view(float).reshape(len(force), -1), 12) + 0.0
    directions, direction = _distinct(unit)
    # Distinct gains, as sensitivities to the nuisance entries, group and coordinate.
    factored = problem.space.model.functions.has_probe_factors
    nuisances = np.ascontiguousarray(nuisance).view(float).reshape(group.size, -1)
    gain_rows = np.column_stack([nuisances, group * factored, coordinate * factored])
    gains, gain = _distinct(gain_rows)
    conditions, condition = _distinct(np.column_stack([group, speed]))
    node, key = _nodes(condition, w, np.column_stack([coordinate, direction, gain, channel]), size)
    segment = _segment_of(condition, node, key)
    order = np.lexsort([node, key, segment])
    segments, entry = _segments(segment[order], key[order], node[order], condition[order])
    first = order[entry]
    return KernelLayout(
        segments=segments,
        datum=entry,
        group=group[conditions],
        speed=speed[conditions],
        frequency=w[order][_distinct(np.column_stack([segment, node])[order])[0]],
        coordinate=coordinate[first],
        direction=direction[first],
        gain=gain[first],
        channel=channel[first],
        directions=np.ascontiguousarray(unit[directions]).view(complex).reshape(-1, size),
        nuisance=nuisance[gains],
        gain_group=gain_rows[gains, -2].astype(np.intp),
        gain_coordinate=gain_rows[gains, -1].astype(np.intp),
        reading=order,
        drive=drive[order],
        sigma=sigma[order],
        measured=measured[order],
    )


def _nodes(condition: Index, w: Float, read: Index, size: int) -> tuple[Index, Index]:
    """Node of each reading, and a key of how it was read; repeats of a reading at a node have keys of their own."""
    node, key = _distinct(np.column_stack([condition, w]))[1], combined(*map(numbers, read.T))
    key = combined(occurrence(combined(node, key)), key)
    if size > LARGEST_UNROLLED:
        return node, key
    # Generated code reads few entries a node: one with very many readings counts as several.
    rank = np.empty(w.size, dtype=np.intp)
    order = np.lexsort([key, node])
    rank[order] = occurrence(node[order])
    return _distinct(np.column_stack([rank // READINGS_OF_A_NODE, node]))[1], key


def _segment_of(condition: Index, node: Index, key: Index) -> Index:
    """Segment of each reading: nodes of one condition that were read by the same keys."""
    order = np.lexsort([key, node])
    starts = np.flatnonzero(np.diff(np.append(-1, node[order])))
    patterns: dict[tuple[int, ...], int] = {}
    of_node = [
        patterns.setdefault((int(condition[order[a]]), *key[order[a:b]].tolist()), len(patterns))
        for a, b in zip(starts, np.append(starts[1:], node.size), strict=True)
    ]
    return np.array(of_node, dtype=np.intp)[node]


def _segments(segment: Index, key: Index, node: Index, condition: Index) -> tuple[Index, Index]:
    """Rows of :attr:`KernelLayout.segments`, and the first reading of each entry, of readings in the kernels' order."""
    entry = np.flatnonzero((np.diff(segment, prepend=-1) != 0) | (np.diff(key, prepend=-1) != 0))
    starts = np.flatnonzero(np.diff(segment, prepend=-1))
    table, nodes = [], 0
    for a, b in zip(starts, np.append(starts[1:], segment.size), strict=True):
        count = np.unique(node[a:b]).size
        e0, e1 = np.searchsorted(entry, [a, b])
        table.append((nodes, nodes + count, condition[a], e0, e1))
        nodes += count
    return np.array(table, dtype=np.intp), entry


BREAK_EVEN_READINGS = 2e7
"""Readings to evaluate (vectors times readings) beyond which kernels are quicker than NumPy's 0.05 microseconds.

It lies between the time to load them from disk and that to compile them. The choice must not depend on which of the two
it is: the same seed gives the same samples, to round-off.
"""
GRADIENT_COST = 5.0
"""NumPy's time for a gradient over that of a misfit."""


class Batch:
    """Channel sums, costs and gradients of many vectors of a problem."""

    def __init__(
        self, problem: Problem, *, accelerate: bool | None = None, work: float = np.inf, gradients: bool = False
    ) -> None:
        self.problem = problem
        linear = np.array([linear_response(block) is not None for block in problem.blocks], dtype=bool)
        readings = work * problem.n_data / 2 * (GRADIENT_COST if gradients else 1.0)
        pays = (readings > BREAK_EVEN_READINGS and accelerator.available()) if accelerate is None else accelerate
        unrolled = len(problem.space.model.coordinates) <= codegen.LARGEST_UNROLLED
        self.compiled = bool(pays and unrolled and linear.any())
        self._kernels = Kernels(_part(problem, linear)) if self.compiled else None
        linear &= self.compiled
        self._in_kernels = np.repeat(linear, [block.measured.size for block in problem.blocks])  # of readings
        self._channels = np.repeat(linear, [len(block.labels) for block in problem.blocks])
        self._rest = _part(problem, ~linear)

    def channel_sums(self, x: Float) -> Float:
        """See :meth:`Problem.channel_sums`."""
        if self._kernels is None:
            return self._rest.channel_sums(x)
        out = np.zeros((len(x), len(self.problem.channel_names)))
        out[:, self._channels], out[:, ~self._channels] = self._kernels.channel_sums(x), self._rest.channel_sums(x)
        return out

    def misses(self, x: Float) -> Float:
        """Whitened residuals, those of each channel together, their real parts before their imaginary ones, each
        turned as :meth:`in_channels` turns columns, shape ``(W, 2 R)``; of a problem that is compiled as a whole or
        not at all."""
        if self._kernels is not None:
            return self._kernels.misses(x, self.places)
        return self.in_channels(np.ascontiguousarray(self.problem.residuals(x)))

    def in_channels(self, columns: ComplexArray) -> Float:
        """Numbers of all readings ``(..., R)`` in the order of :meth:`misses`, shape ``(..., 2 R)``."""
        columns = columns * self._turn
        found = np.empty((*columns.shape[:-1], 2 * columns.shape[-1]))
        found[..., self.places[0]], found[..., self.places[1]] = columns.real, columns.imag
        return found

    @cached_property
    def parts(self) -> list[slice]:
        """Places of each channel in the order of :meth:`misses`."""
        ends = np.cumsum(self.problem.channel_counts).tolist()
        return [slice(first, end) for first, end in zip([0, *ends], ends, strict=False)]

    @cached_property
    def places(self) -> tuple[Index, Index]:
        """Places there of both parts of each reading, those of an entry of the kernels one after the other."""
        channel, counts = self.problem.channel, self.problem.channel_counts // 2
        order = np.arange(channel.size) if self._kernels is None else self._kernels.readings
        order, place = order[np.argsort(channel[order], kind="stable")], np.empty(channel.size, dtype=np.intp)
        place[order] = np.arange(channel.size)
        place += (np.cumsum(counts) - counts)[channel]
        return place, place + counts[channel]

    @cached_property
    def _turn(self) -> ComplexArray | float:
        return 1.0 if self._kernels is None else self._kernels.turn

    def cost_and_gradient(self, x: Float) -> tuple[Float, Float]:
        """Costs of the problem and their exact gradients, shapes ``(W,)`` and ``(W, p)``."""
        return self._sums(x, None, None)

    def of_readings(self, measured: ComplexArray) -> Callable[[Float, Index], tuple[Float, Float]]:
        """The same of vectors of some members, which have readings ``(M, R)`` in place of the problem's."""
        chosen = self._in_kernels
        rest = measured[:, ~chosen] if chosen.any() else measured
        sorted_ = self._kernels.sorted(measured if chosen.all() else measured[:, chosen]) if self._kernels else None

        def evaluate(x: Float, members: Index) -> tuple[Float, Float]:
            some = slice(None) if members.size == len(measured) else members  # of all of them without a copy
            targets = None if sorted_ is None else (sorted_[0][some], sorted_[1][some])
            return self._sums(x, rest[some], targets)

        return evaluate

    def _sums(
        self, x: Float, measured: ComplexArray | None, targets: tuple[Float, Float] | None
    ) -> tuple[Float, Float]:
        cost, gradient, _ = self._rest.evaluate(x, measured, matrix=False)
        if self._kernels is not None:
            self._kernels.add(x, targets, cost, gradient)
        return cost, gradient


def _part(problem: Problem, chosen: Bool) -> Problem:
    """Some blocks of a problem with all of its priors; the problem itself where that is all of them."""
    if chosen.all():
        return problem
    numbers = np.flatnonzero(chosen).tolist()
    factors = tuple(problem.factors[i] for i in numbers) if problem.factors else ()
    return replace(problem, blocks=tuple(problem.blocks[i] for i in numbers), factors=factors)


class Kernels:
    """Compiled sums over the readings of a problem whose blocks are responses to forces of a linear model."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self._plan = problem, layout(problem)

    def channel_sums(self, x: Float) -> Float:
        """See :meth:`Problem.channel_sums`."""
        x, out = np.ascontiguousarray(x, dtype=float), np.zeros((len(x), len(self.problem.channel_names)))
        if x.size:
            self._functions["sums"](x, *self._fixed, *self._data, *_split(self._gains(x)), self._plan.channel, out)
        return out

    @property
    def readings(self) -> Index:
        """Readings in the order of the kernels."""
        return self._plan.reading

    @cached_property
    def turn(self) -> ComplexArray:
        """By which each reading is turned so that its force drives it without phase, shape ``(R,)``."""
        drive, found = self._plan.drive, np.empty(self._plan.drive.size, dtype=complex)
        found[self._plan.reading] = drive.conj() / np.abs(drive)
        return found

    def misses(self, x: Float, places: tuple[Index, Index]) -> Float:
        """Whitened residuals at the places of both parts of each reading, turned, shape ``(W, 2 R)``."""
        x, first = np.ascontiguousarray(x, dtype=float), self._plan.reading[self._plan.datum]
        out, (re, im, weight) = np.empty((len(x), 2 * self._plan.reading.size)), self._data
        if x.size:
            data = (re, im, np.sqrt(weight), *_split(self._gains(x)))
            self._functions["misses"](x, *self._fixed, *data, places[0][first], places[1][first], out)
        return out

    def sorted(self, measured: ComplexArray) -> tuple[Float, Float]:
        """Responses to unit forces in the order of the kernels, real and imaginary parts, shapes ``(W, Q)``."""
        order, per_drive = self._plan.reading, 1.0 / self._plan.drive
        re, im = np.empty((len(measured), order.size)), np.empty((len(measured), order.size))
        for m, row in enumerate(measured):
            target = row[order] * per_drive
            re[m], im[m] = target.real, target.imag
        return re, im

    def add(self, x: Float, targets: tuple[Float, Float] | None, cost: Float, gradient: Float) -> None:
        """Add costs without priors, and their gradients."""
        x = np.ascontiguousarray(x, dtype=float)
        re, im = _split(self._gains(x))
        seed_re, seed_im = np.zeros_like(re), np.zeros_like(im)
        target_re, target_im = self._data[:2] if targets is None else targets
        self._functions["slopes"](
            x, *self._fixed, target_re, target_im, self._data[2], re, im, cost, gradient, seed_re, seed_im
        )
        if not self._has_gains:
            return
        # The slope by the gains (by re + j by im) is chained to the vector.
        plan, space, functions = self._plan, self.problem.space, self.problem.space.model.functions
        pulled = (seed_re - 1j * seed_im) * self._gains(x)
        gradient[:, len(space.names) :] += (pulled @ plan.nuisance).real
        if functions.has_probe_factors:
            theta = space.theta(x)
            factor = functions.factors(theta)[:, plan.gain_group, plan.gain_coordinate]
            by_theta = functions.factor_jacobian(theta)[:, plan.gain_group, plan.gain_coordinate]
            pull = ((pulled / factor)[:, :, None] * by_theta).real
            for g, row in enumerate(plan.gain_group):
                gradient += space.pull_back(pull[:, g], row)

    # ---- gains: nuisance entries and probe factors -------------------------------------------------------------------

    @cached_property
    def _has_gains(self) -> bool:
        """True if predictions are multiplied by something that depends on the vector."""
        factored = self.problem.space.model.functions.has_probe_factors
        return factored or bool(self._plan.nuisance.any())

    def _gains(self, x: Float) -> ComplexArray:
        """Factor of each distinct gain, shape ``(W, number of gains)``."""
        plan = self._plan
        if not self._has_gains:
            return np.ones((1, plan.gain_group.size), dtype=complex)
        gain = np.exp(x[:, len(self.problem.space.names) :] @ plan.nuisance.T)
        functions = self.problem.space.model.functions
        if functions.has_probe_factors:
            gain = gain * functions.factors(self.problem.space.theta(x))[:, plan.gain_group, plan.gain_coordinate]
        return np.asarray(gain, dtype=complex)

    # ---- numba -------------------------------------------------------------------------------------------------------

    @cached_property
    def _patterns(self) -> tuple[tuple[codegen.Pattern, ...], Index]:
        """Distinct ways of reading a node, and the one of each segment."""
        plan = self._plan
        axis = [int(np.argmax(u)) if np.count_nonzero(u) == 1 and u.max() == 1 else -1 for u in plan.directions.real]
        axis = [a if not plan.directions[i].imag.any() else -1 for i, a in enumerate(axis)]
        seen: dict[codegen.Pattern, int] = {}
        numbers = [
            seen.setdefault(
                codegen.Pattern(
                    tuple((int(plan.coordinate[e]), axis[plan.direction[e]]) for e in range(e0, e1)),
                    self._has_gains,
                    self.problem.loss,
                ),
                len(seen),
            )
            for _, _, _, e0, e1 in plan.segments
        ]
        return tuple(seen), np.array(numbers, dtype=np.intp)

    @cached_property
    def _functions(self) -> dict[str, accelerator.Kernel]:
        return accelerator.compile_kernels(codegen.source(self.problem.space.model, self._patterns[0]))

    @cached_property
    def _fixed(self) -> tuple[Any, ...]:
        plan, space = self._plan, self.problem.space
        conditions = (space.template, space.index, plan.group, plan.speed, plan.frequency)
        entries = (plan.segments, self._patterns[1], plan.datum, plan.gain, plan.direction)
        return tuple(map(np.ascontiguousarray, (*conditions, *entries, plan.directions.real, plan.directions.imag)))

    @cached_property
    def _data(self) -> tuple[Float, Float, Float]:
        return (*_split(self._plan.target[None, :]), np.ascontiguousarray(self._plan.weight))


def _split(values: ComplexArray) -> tuple[Float, Float]:
    return np.ascontiguousarray(values.real), np.ascontiguousarray(values.imag)
