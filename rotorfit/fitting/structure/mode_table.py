"""Modes of a fitted rotor with their errors, as a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.fitting.quantities import Quantity
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.digits import plus_minus, significant
from rotorfit.models.motion.modes import modal_assurance
from rotorfit.models.parameters import unknown_name
from rotorfit.models.text_table import Printed, text_table
from rotorfit.units import RPM_PER_RAD_S


@dataclass(frozen=True, eq=False, kw_only=True)
class Mode:
    """One mode of a fitted rotor.

    Attributes:
        frequency: natural frequency, rad/s: undamped where ``mass`` is there, else damped, negative for backward whirl.
        damping_ratio: share of critical damping.
        half_power: the same from the half-power bandwidth of the measured responses, median over these; NaN where none
            has the peak with both sides.
        shape: deflection at each plane, one at that of the normalisation; its sign, or, of a rotor that is not passive,
            its size, whose phase is ``phase``.
        phase: lead of each plane's motion in x + j y over that of the normalisation, rad; zero of a passive rotor.
        mass, stiffness, damping: of the mode by itself (the paper's M_I, K_I, D_I), kg, N/m, N s/m; None for a rotor
            that is not passive, whose modes have none of their own.
    """

    frequency: Quantity
    damping_ratio: Quantity
    half_power: float
    shape: Mapping[str, Quantity]
    phase: Mapping[str, Quantity]
    mass: Quantity | None
    stiffness: Quantity | None
    damping: Quantity | None

    @property
    def vector(self) -> ComplexArray:
        """Deflections as complex numbers, in the order of ``shape``, shape ``(n,)``."""
        size = np.array([q.value for q in self.shape.values()])
        return size * np.exp(1j * np.array([q.value for q in self.phase.values()]))


@dataclass(frozen=True, eq=False, repr=False)
class Modes(Printed, Sequence[Mode]):
    """The modes of a fitted rotor at a speed, by natural frequency; ``print`` shows them as a table.

    Attributes:
        modes: one after the other.
        speed: rotative speed, rad/s.
    """

    modes: tuple[Mode, ...]
    speed: float

    def __len__(self) -> int:
        return len(self.modes)

    def __getitem__(self, number: Any) -> Any:
        """Return one mode, or several, by number from zero."""
        return self.modes[number]

    def mac(self, shapes: Mapping[str, ArrayLike] | ArrayLike) -> Float:
        """Modal assurance criterion of each mode (rows) and each given shape (columns), 1 where they are alike.

        Args:
            shapes: deflections of each shape by plane, ``{"inboard": [1, 1], "outboard": [0.99, -0.94]}``; planes that
                are not named do not count. Or an array ``(planes, shapes)``, planes in the order of ``shape``.

        Raises:
            KeyError: a plane that the rotor has not.
            ValueError: planes with different numbers of shapes, or fewer than two planes.

        Example:
            >>> fit = rf.fit(rf.models.TwoDisk(), rf.datasets.two_disk())
            >>> fit.modes().mac({"inboard": [1, 1], "outboard": [0.99, -0.94]}).round(2).tolist()
            [[1.0, 0.0], [0.0, 1.0]]
        """
        names = list(self.modes[0].shape)
        given = shapes if isinstance(shapes, Mapping) else dict(zip(names, np.asarray(shapes), strict=True))
        for name in given:
            if name not in names:
                raise KeyError(unknown_name("plane of the rotor", name, names))
        columns = [np.atleast_1d(np.asarray(values, dtype=complex)) for values in given.values()]
        if len(columns) < 2 or len({column.shape for column in columns}) > 1:
            raise ValueError("a shape needs its deflections at two planes or more, as many at each plane")
        places = [names.index(name) for name in given]
        others = list(np.stack(columns, axis=1))
        return np.array([[modal_assurance(mode.vector[places], other) for other in others] for mode in self.modes])

    def rows(self) -> list[list[str]]:
        """The table as text, its head first."""
        planes = list(self.modes[0].shape) if self.modes else []
        parts = self.modes[0].mass is not None if self.modes else False
        head = ["mode", "frequency, rpm", "damping ratio", "half-power"]
        head += ["mass, kg", "stiffness, N/m", "damping, N s/m"] * parts
        rows = [[*head, *(f"at {plane}" for plane in planes)]]
        for number, mode in enumerate(self.modes, 1):
            row = [str(number), _said(mode.frequency, RPM_PER_RAD_S), _said(mode.damping_ratio)]
            row.append(significant(mode.half_power, 3) if np.isfinite(mode.half_power) else "-")
            row += [_said(q) for q in (mode.mass, mode.stiffness, mode.damping) if q is not None]
            row += [_deflection(mode, plane) for plane in planes]
            rows.append(row)
        return rows

    def numbers(self) -> list[list[Any]]:
        """The table in SI units, each number with its standard error, its head first."""
        named = [_numbers(mode) for mode in self.modes]
        head = [part for name in (named[0] if named else ()) for part in (name, f"{name}_stderr")]
        rows = [[part for q in one.values() for part in (q.value, q.stderr)] for one in named]
        return [
            ["mode", "half_power", *head],
            *([k, mode.half_power, *row] for k, (mode, row) in enumerate(zip(self.modes, rows, strict=True), 1)),
        ]

    def __str__(self) -> str:
        rows = self.rows()
        return "\n".join(text_table(rows, ">4 " + ">8 " * (len(rows[0]) - 1)))

    __repr__ = __str__


def _numbers(mode: Mode) -> dict[str, Quantity]:
    """Quantities of a mode by name and unit."""
    found = {"frequency_rad_s": mode.frequency, "damping_ratio": mode.damping_ratio}
    own = {"mass_kg": mode.mass, "stiffness_N_m": mode.stiffness, "damping_N_s_m": mode.damping}
    found |= {name: q for name, q in own.items() if q is not None}
    found |= {f"shape_{plane}": q for plane, q in mode.shape.items()}
    return found if own["mass_kg"] else found | {f"phase_{plane}_rad": q for plane, q in mode.phase.items()}


def _said(q: Quantity, factor: float = 1.0) -> str:
    return plus_minus(q.value * factor, q.stderr * factor)


def _deflection(mode: Mode, plane: str) -> str:
    shape, phase = mode.shape[plane], mode.phase[plane]
    turned = f" at {round(np.degrees(phase.value))} deg" if abs(phase.value) > 1e-9 else ""
    return (significant(shape.value, 4) if shape.stderr == 0 else _said(shape)) + turned
