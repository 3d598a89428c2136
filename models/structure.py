"""Structural blocks that a lumped chain of masses and springs leaves out.

Condensing a shaft to a few planes leaves coupling between them that is symmetric when the shaft is passive and
isotropic:
a coupling mass, a gyroscopic matrix, damping between planes where a support or a further disk is damped, and above all
modes in band terms in w^4 and, gyroscopic or damped, in w^3. Damping inside the shaft turns with it. Whole blocks go in
or stay out.

What moves between the planes adds ``-R^T (K - w^2 M + w Om G)^-1 R`` with ``R = w^2 M - w Om G``, which begins with the
square of R: w^4, w^3 Om and w^2 Om^2 are of one order. The next ones are smaller by (w / w_c)^2, w_c the lowest natural
frequency with the planes held: where that is not far above the band, as with a further disk, w^6 is asked for too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from rotorfit.base.names import unknown_name
from rotorfit.models.complexes import Complex
from rotorfit.models.parameters import Parameter

Terms = tuple[tuple[complex, int, int], ...]
"""Factor, power of s and power of the rotative speed, of each part of what multiplies entries of a matrix."""


class Block(NamedTuple):
    """A block of symmetric matrices."""

    symbol: str  # that names of its parameters begin with
    unit: str
    scale: float  # typical size, in the unit
    terms: Terms


BLOCK_TABLE = {
    "coupling_mass": Block("m", "kg", 0.05, ((1.0, 2, 0),)),
    "gyroscopic": Block("g", "kg", 0.01, ((-1j, 1, 1),)),
    "coupling_damping": Block("c", "N s/m", 1.0, ((1.0, 1, 0),)),
    "internal_damping": Block("ci", "N s/m", 0.1, ((1.0, 1, 0), (-1j, 0, 1))),
    "out_of_band": Block("q", "kg s^2", 1e-8, ((1.0, 4, 0),)),
    "next_out_of_band": Block("r", "kg s^4", 1e-14, ((1.0, 6, 0),)),
    "gyroscopic_out_of_band": Block("h", "kg s^2", 1e-8, ((1j, 3, 1),)),
    "gyroscopic_squared": Block("e", "kg s^2", 1e-8, ((1.0, 2, 2),)),
    "damping_out_of_band": Block("d", "kg s", 1e-6, ((1.0, 3, 0),)),
}
"""As dynamic stiffness, with s = j w: ``-w^2 m``, ``+w Om g``, ``+j w c``, ``+j (w - Om) ci``, ``+w^4 q``, ``-w^6 r``,
``+w^3 Om h``, ``-w^2 Om^2 e`` and ``-j w^3 d``."""

BLOCKS = tuple(BLOCK_TABLE)
"""Names of the blocks, in the order in which a refinement adds them."""

_BETWEEN = ("coupling_mass", "coupling_damping")  # the planes' own masses and dampers are parameters of the models


def check_blocks(blocks: Sequence[str]) -> tuple[str, ...]:
    """Return the blocks in canonical order."""
    for block in blocks:
        if block not in BLOCKS:
            raise ValueError(unknown_name("structural block", block, BLOCKS))
    return tuple(block for block in BLOCKS if block in blocks)


def block_symbols(blocks: Sequence[str]) -> str:
    """Symbols of blocks, for instance ``m g c q``, which the names of their parameters begin with."""
    return " ".join(BLOCK_TABLE[block].symbol for block in blocks)


def _entries(block: str, size: int) -> list[tuple[int, int, str]]:
    separator = "" if size < 10 else "_"
    pairs = [(row, column) for row in range(size) for column in range(row, size)]
    if block in _BETWEEN:
        pairs = [(row, column) for row, column in pairs if row != column]
    if block == "internal_damping":  # sections of the shaft: from the first bearing, and from plane to plane
        pairs = [(0, 0), *((row, row + 1) for row in range(size - 1))]
    return [(row, column, f"{BLOCK_TABLE[block].symbol}{row + 1}{separator}{column + 1}") for row, column in pairs]


def block_parameters(blocks: Sequence[str], size: int) -> tuple[Parameter, ...]:
    """Parameters of the blocks, for instance m12; g11, g12, g22; c12; ci11, ci12; q11, ..."""
    return tuple(
        Parameter(
            name, BLOCK_TABLE[block].unit, f"{block.replace('_', ' ')} between planes", scale=BLOCK_TABLE[block].scale
        )
        for block in blocks
        for _, _, name in _entries(block, size)
    )


def add_blocks(matrices: Sequence[Any], blocks: Sequence[str], p: Any, speed: Any) -> list[Complex]:
    """Add blocks to coefficients by powers of s = j w."""
    result = [Complex.matrix(m) for m in matrices]
    size = result[0].shape[0]
    for block in blocks:
        values: list[list[Any]] = [[0.0] * size for _ in range(size)]
        for row, column, name in _entries(block, size):
            value = getattr(p, name)
            if block == "internal_damping" and row != column:  # a section resists what its ends do apart
                values[row][row] = values[row][row] + value
                values[column][column] = values[column][column] + value
                value = -value
            values[row][column] = values[column][row] = value if row != column else values[row][row] + value
        addition = Complex.matrix(values)
        for factor, power, speeds in BLOCK_TABLE[block].terms:
            while len(result) <= power:
                result.append(Complex.matrix([[0.0] * size for _ in range(size)]))
            term = addition
            for _ in range(speeds):
                term = term * speed
            result[power] = result[power] + factor * term
    return result
