"""Readings of a problem sorted so that one inverse of the dynamic stiffness serves all of a condition and line."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.blocks.row_keys import occurrence
from rotorfit.estimators.misfit.codegen import LARGEST_UNROLLED
from rotorfit.estimators.misfit.problem import Problem
from rotorfit.models.array_types import ComplexArray, Float, Index

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
    """First place of each distinct row, ascending, and each row's number; column by column, as records sort slowly."""
    number = np.zeros(len(rows), dtype=np.intp)
    for column in rows.T:
        values, own = np.unique(column, return_inverse=True)
        number = np.unique(number * values.size + own, return_inverse=True)[1]
    return np.unique(number, return_index=True)[1], number


def _codes(columns: Float | Index) -> Index:
    """Number rows by equality."""
    return _distinct(columns)[1]


def layout(problem: Problem) -> KernelLayout:
    """Sort the readings of a problem, all of them responses to forces, in the order of the kernels.

    Readings x at the frequencies 1, 2, 3 and y at 1 and 3 become two segments::

        node       1   2   3        segment 0: nodes 1, 3, entries x, y: data x1 x3 y1 y3
        read as    xy  x   xy       segment 1: node 2,     entry x:      datum x2
    """
    parts: list[tuple[NDArray[Any], ...]] = []
    for i, block in enumerate(problem.blocks):
        if not isinstance(block, Responses):
            raise TypeError(f"{type(block).__name__} are no responses to forces")
        line = block.line
        speed = block.speed if block.model.speed_dependent else np.zeros_like(block.speed)
        factors = problem.factors[i] if problem.factors else None
        nuisance = np.zeros((line.size, len(problem.space.nuisance)), dtype=complex) if factors is None else factors
        own = (block.group[line], speed[line], block.s[line].imag, block.coordinate, block.force[line])
        parts.append((*own, nuisance, block.sigma, block.measured))
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
    node, key = _codes(np.column_stack([condition, w])), _codes(read)
    key = _codes(np.column_stack([occurrence(_codes(np.column_stack([node, key]))), key]))
    if size > LARGEST_UNROLLED:
        return node, key
    # Generated code reads few entries a node: one with very many readings counts as several.
    rank = np.empty(w.size, dtype=np.intp)
    order = np.lexsort([key, node])
    rank[order] = occurrence(node[order])
    return _codes(np.column_stack([rank // READINGS_OF_A_NODE, node])), key


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
