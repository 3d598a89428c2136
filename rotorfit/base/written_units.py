"""Units that numbers carry, as people write them, ``N s/mm`` or ``kg m^2``: products, and factors between them."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from rotorfit.base.names import unknown_name
from rotorfit.base.units import ANGLE, UNITS, find_unit

_SHOWN = ({"N": 1, "m": -1}, {"N": 1}, {"N": 1, "s": 1, "m": -1}, {"N": 1, "m": 1})
"""Units with a newton that are written as such: stiffness, force, damping, moment."""
_SI = {
    "frequency": "rad/s",
    "displacement": "m",
    "tilt": "rad",
    "velocity": "m/s",
    "acceleration": "m/s^2",
    "force": "N",
    "unbalance": "kg m",
}
"""SI unit of quantities whose units may stand by themselves."""
_NEWTON = {"kg": 1, "m": 1, "s": -2}


def _powers(unit: str) -> dict[str, float]:
    """Powers of the units that one is written with, ``N s/mm`` or ``kg m^2``."""
    above, _, below = unit.partition("/")
    found: dict[str, float] = {}
    for text, sign in ((above, 1), (below.strip("()"), -1)):
        for name, power in re.findall(r"([A-Za-z_\u00b5\u03bc]+)\^?(-?\d+(?:\.\d+)?)?", text):
            found[name] = found.get(name, 0) + sign * float(power or 1)
    return found


def _in_base(found: Mapping[str, float]) -> dict[str, float]:
    """The same without newtons."""
    base = {name: float(size) for name, size in found.items() if name != "N"}
    for name, size in _NEWTON.items():
        base[name] = base.get(name, 0.0) + size * found.get("N", 0)
    return {name: size for name, size in base.items() if size}


def si_of(unit: str, like: str) -> float:
    """Factor that takes a value in a unit to SI; a unit of something else than ``like`` is refused.

    Args:
        unit: such as rpm, mil_pp, kN/mm or N s/mm.
        like: another unit of what is meant.
    """
    wanted = _factor_and_dimensions(like)[1]
    for quantity, si in _SI.items():  # g is 9.80665 m/s^2 of an acceleration, and a gram within another unit
        if _factor_and_dimensions(si)[1] == wanted:
            factor = find_unit(unit.replace("^", "").replace("/", "_").replace(" ", "_"), UNITS[quantity])
            if factor is not None:
                return factor
    factor, found = _factor_and_dimensions(unit)
    if found != wanted:
        raise ValueError(f"{like or '1'} cannot be given in {unit or '1'}: that is a unit of something else")
    return factor


def _factor_and_dimensions(unit: str) -> tuple[float, dict[str, float]]:
    """Factor to SI of a written unit, and its powers of kg, m and s."""
    total, found = 1.0, dict.fromkeys(_NEWTON, 0.0)
    for name, power in _powers(unit).items():
        known = next((k for k in _ATOMS if (size := find_unit(name, k[0])) is not None), None)
        if known is None:
            allowed = dict.fromkeys(one for units, _ in _ATOMS for one in units)
            raise ValueError(f"in {unit!r}: {unknown_name('unit', name, allowed)}")
        units, dimensions = known
        total *= (find_unit(name, units) or 1.0) ** power
        for base, size in dimensions.items():
            found[base] += size * power
    return total, {name: size for name, size in found.items() if size}


_ATOMS: tuple[tuple[Mapping[str, float], Mapping[str, float]], ...] = (
    (UNITS["length"], {"m": 1}),
    ({"s": 1.0, "ms": 1e-3}, {"s": 1}),
    ({"kg": 1.0, "g": 1e-3}, {"kg": 1}),
    (UNITS["force"], _NEWTON),
    (ANGLE, {}),
    ({name: size for name, size in UNITS["frequency"].items() if name != "rad_s"}, {"s": -1}),
)
"""Units that others are written with: factors to SI, and their powers of kg, m and s."""


# ---- products --------------------------------------------------------------------------------------------------------


def shown_unit(unit: str) -> str:
    """A unit behind a number, where a number without dimension has none."""
    return "" if unit == "1" else unit


def product_unit(factors: Iterable[tuple[str, float]]) -> str:
    """Unit of a product of powers of units."""
    units = list(factors)
    if len(units) == 1 and units[0][1] == 1:
        return units[0][0]
    total: dict[str, float] = {}
    for unit, power in units:
        for name, size in dimensions(unit).items():
            total[name] = total.get(name, 0) + power * size
    total = {name: size for name, size in total.items() if size}
    for shown in _SHOWN:
        if _in_base(shown) == total:
            return _written(shown)
    return _written(total)


def dimensions(unit: str) -> dict[str, float]:
    """Powers of kg, m and s in a unit such as ``N s/m`` or ``kg m^2``; a radian is a number."""
    return {name: size for name, size in _in_base(_powers(unit)).items() if name != "rad"}


def _written(found: Mapping[str, float]) -> str:
    above = [_power(name, size) for name, size in found.items() if size > 0]
    below = [_power(name, -size) for name, size in found.items() if size < 0]
    under = below[0] if len(below) == 1 else f"({' '.join(below)})"
    return " ".join(above) or "1" if not below else f"{' '.join(above) or '1'}/{under}"


def _power(name: str, size: float) -> str:
    return name if size == 1 else f"{name}^{size:g}"
