"""Structural blocks that a lumped chain of masses and springs leaves out.

Condensing a shaft to a few planes leaves coupling between them that is symmetric when the shaft is passive and
isotropic:
a coupling mass, a gyroscopic matrix, and above all modes in band a term in w^4. Whole blocks go in or stay out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rotorfit.models.complexes import Complex, J
from rotorfit.models.parameters import Parameter, unknown_name

BLOCKS = ("coupling_mass", "gyroscopic", "out_of_band")
"""Names of the blocks, in the order in which a refinement adds them."""

_SYMBOL = {"coupling_mass": "m", "gyroscopic": "g", "out_of_band": "q"}
_UNIT = {"coupling_mass": "kg", "gyroscopic": "kg", "out_of_band": "kg s^2"}
_SCALE = {"coupling_mass": 0.05, "gyroscopic": 0.01, "out_of_band": 1e-8}


def check_blocks(blocks: Sequence[str]) -> tuple[str, ...]:
    """Return the blocks in canonical order.

    Raises:
        ValueError: unknown block.
    """
    for block in blocks:
        if block not in BLOCKS:
            raise ValueError(unknown_name("structural block", block, BLOCKS))
    return tuple(block for block in BLOCKS if block in blocks)


def _entries(block: str, size: int) -> list[tuple[int, int, str]]:
    separator = "" if size < 10 else "_"
    return [
        (row, column, f"{_SYMBOL[block]}{row + 1}{separator}{column + 1}")
        for row in range(size)
        for column in range(row, size)
        if row != column or block != "coupling_mass"
    ]


def block_parameters(blocks: Sequence[str], size: int) -> tuple[Parameter, ...]:
    """Parameters of the blocks between ``size`` planes, for instance m12; g11, g12, g22; q11, q12, q22."""
    return tuple(
        Parameter(name, _UNIT[block], f"{block.replace('_', ' ')} between planes", scale=_SCALE[block])
        for block in blocks
        for _, _, name in _entries(block, size)
    )


def add_blocks(matrices: Sequence[Any], blocks: Sequence[str], p: Any, speed: Any) -> list[Complex]:
    """Add ``-w^2 m``, ``+w Om g`` and ``+w^4 q`` to coefficient matrices sorted by powers of s = j w."""
    result = [Complex.matrix(m) if not isinstance(m, Complex) else m for m in matrices]
    size = result[0].shape[0]
    for block in blocks:
        values: list[list[Any]] = [[0.0] * size for _ in range(size)]
        for row, column, name in _entries(block, size):
            values[row][column] = values[column][row] = getattr(p, name)
        addition = Complex.matrix(values)
        if block == "coupling_mass":
            result[2] = result[2] + addition
        elif block == "gyroscopic":
            result[1] = result[1] - J * (addition * speed)
        else:
            while len(result) < 5:
                result.append(Complex.matrix([[0.0] * size for _ in range(size)]))
            result[4] = result[4] + addition
    return result
