"""Structural blocks that a lumped chain of masses and springs leaves out.

Condensing a shaft to a few planes leaves coupling between them that is symmetric when the shaft is passive and
isotropic:
a coupling mass, a gyroscopic matrix, damping between planes where a support or a further disk is damped, and above all
modes in band terms in w^4 and, gyroscopic, in w^3. Whole blocks go in or stay out.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rotorfit.models.complexes import Complex, J
from rotorfit.models.parameters import Parameter, unknown_name

BLOCKS = ("coupling_mass", "gyroscopic", "coupling_damping", "out_of_band", "gyroscopic_out_of_band")
"""Names of the blocks, in the order in which a refinement adds them."""

_SYMBOL = dict(zip(BLOCKS, ("m", "g", "c", "q", "h"), strict=True))
_UNIT = dict(zip(BLOCKS, ("kg", "kg", "N s/m", "kg s^2", "kg s^2"), strict=True))
_SCALE = dict(zip(BLOCKS, (0.05, 0.01, 1.0, 1e-8, 1e-8), strict=True))
_BETWEEN = ("coupling_mass", "coupling_damping")  # the planes' own masses and dampers are parameters of the models


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
        if row != column or block not in _BETWEEN
    ]


def block_parameters(blocks: Sequence[str], size: int) -> tuple[Parameter, ...]:
    """Parameters of the blocks between ``size`` planes, for instance m12; g11, g12, g22; c12; q11, q12, q22."""
    return tuple(
        Parameter(name, _UNIT[block], f"{block.replace('_', ' ')} between planes", scale=_SCALE[block])
        for block in blocks
        for _, _, name in _entries(block, size)
    )


def add_blocks(matrices: Sequence[Any], blocks: Sequence[str], p: Any, speed: Any) -> list[Complex]:
    """Add ``-w^2 m``, ``+w Om g``, ``+j w c``, ``+w^4 q`` and ``+w^3 Om h`` to coefficients by powers of s = j w."""
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
        elif block == "coupling_damping":
            result[1] = result[1] + addition
        else:
            power = 4 if block == "out_of_band" else 3
            while len(result) <= power:
                result.append(Complex.matrix([[0.0] * size for _ in range(size)]))
            result[power] = result[power] + (addition if power == 4 else J * (addition * speed))
    return result
