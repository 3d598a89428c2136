"""Terms that the equation of motion of a model may lack, as additions to its dynamic stiffness at the planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.model import RotorModel
from rotorfit.models.motion.stability import Threshold, eigenvalue_gradient, mode_vectors, seats

Entries = tuple[tuple[int, int, float], ...]


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """A term ``t (a + b Om + c Om^2) s^k E`` that adds to kappa, linear in its size t."""

    name: str  # symbol and planes
    meaning: str  # in words
    unit: str  # SI unit of its size
    entries: Entries  # row, column and factor of each nonzero of E
    power: int  # k
    constant: complex = 0.0  # a, b and c; b is complex, as for gyroscopic terms
    by_speed: complex = 0.0
    by_speed_squared: float = 0.0
    more: tuple[tuple[int, complex, complex], ...] = ()  # further powers with factors of their own, ``(k, a, b)``

    def factor(self, s: ComplexArray, speed: Float) -> ComplexArray:
        """Factor of E, broadcasting."""
        parts = ((self.power, self.constant, self.by_speed), *self.more)
        squared = self.by_speed_squared * speed**2 * s**self.power
        return np.asarray(squared + sum((a + b * speed) * s**k for k, a, b in parts), dtype=complex)

    @property
    def speed_power(self) -> int:
        """Power of the rotative speed that the term grows by."""
        return 2 if self.by_speed_squared else 1 if self.by_speed else 0


def terms_left_out(model: RotorModel) -> tuple[LeftOut, ...]:
    """Passive structure between and at the planes of an isotropic rotor that a model has no parameter for. Symmetric
    coupling damping and mass, gyroscopic terms and their next order in frequency, internal damping of the shaft,
    external damping where the fluid acts; empty for models with x and y apart."""
    if model.frame != "z" or any(c.axis != "z" for c in model.coordinates):
        return ()
    planes, blocks = list(model.planes), getattr(model, "blocks", ())
    found = []
    for i, first in enumerate(planes):
        for j in range(i, min(i + 2, len(planes))):
            both = ((i, i, 1.0),) if i == j else ((i, j, 1.0), (j, i, 1.0))
            where = f"[{first}]" if i == j else f"[{first}, {planes[j]}]"
            if i != j and "coupling_mass" not in blocks:
                found.append(_term("m" + where, "coupling mass", "kg", both, 2))
            if i != j and "coupling_damping" not in blocks:
                found.append(_term("c" + where, "coupling damping", "N s/m", both, 1))
            if i != j and "internal_damping" not in blocks:
                found.append(_internal(where, ((i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0))))
            if "gyroscopic" not in blocks:
                found.append(_term("g" + where, "gyroscopic effect", "kg", both, 1, constant=0.0, by_speed=-1j))
            if len(planes) > 1:
                found += [_beyond(expansion, blocks, where, both) for expansion in _BEYOND]
    if len(planes) == 1 and "Ds" in model.parameter_names:
        found.append(_internal(f"[{planes[0]}]", ((0, 0, 1.0),)))
    fluid, external = _damping_coordinates(model)
    for i in sorted(fluid - external):
        meaning = "external damping beside the fluid's, counted in D and lam"
        found.append(_term(f"Ds[{planes[i]}]", meaning, "N s/m", ((i, i, 1.0),), 1))
    return tuple(found)


def _term(
    name: str, meaning: str, unit: str, entries: Entries, power: int, constant: complex = 1.0, **factors: Any
) -> LeftOut:
    return LeftOut(name=name, meaning=meaning, unit=unit, entries=entries, power=power, constant=constant, **factors)


def _internal(where: str, entries: Entries) -> LeftOut:
    return _term("ci" + where, "internal damping of the shaft", "N s/m", entries, 1, more=((0, 0.0, -1j),))


_Expansion = tuple[str, str, tuple[str, ...], int, tuple[str, ...], int]
_BEYOND: tuple[_Expansion, ...] = (
    ("h", "gyroscopic effect", ("gyroscopic_out_of_band",), 3, ("kg s^2", "kg s^4"), 1),
    ("e", "gyroscopic effect squared", ("gyroscopic_squared",), 2, ("kg s^2", "kg s^4"), 2),
    ("d", "damping that changes with frequency", ("damping_out_of_band",), 3, ("kg s", "kg s^3"), 0),
    ("q", "modes above the band", ("out_of_band", "next_out_of_band"), 4, ("kg s^2", "kg s^4", "kg s^6"), 0),
)
"""Expansions in the square of the frequency: symbol (those after the first have their power in it), meaning, structural
blocks that hold the first terms in order, power of the first, units, and power of the rotative speed."""


def _beyond(expansion: _Expansion, blocks: Sequence[str], where: str, entries: Entries) -> LeftOut:
    """The first term of an expansion that a model lacks."""
    symbol, meaning, held, first, units, speed = expansion
    order = next((k for k, block in enumerate(held) if block not in blocks), len(held))
    power = first + 2 * order
    name = f"{symbol}{power if order else ''}{where}"
    meaning = f"{meaning}, w^{power}{' Om^2' if speed == 2 else ''}"
    turning, squared = 1j * (-1) ** order * (speed == 1), float(speed == 2)
    constant = float(speed == 0)
    return _term(name, meaning, units[order], entries, power, constant, by_speed=turning, by_speed_squared=squared)


def fluid_coordinates(model: RotorModel) -> list[int]:
    """Coordinates at which fluid damping D acts."""
    return sorted(_damping_coordinates(model)[0])


def _damping_coordinates(model: RotorModel) -> tuple[set[int], set[int]]:
    """Coordinates at which fluid damping D acts, and those with external damping."""
    names = model.parameter_names
    if "D" not in names:
        return set(), set()
    jacobian = model.functions.jacobian(model.vector({q.name: 1.0 for q in model.parameters}), 1.0, 0.0)
    damping = (jacobian.powers == 1) & (jacobian.rows == jacobian.columns)
    at = {name: set(jacobian.rows[damping & (jacobian.inputs == k)].tolist()) for k, name in enumerate(names)}
    return at["D"], set().union(*(rows for name, rows in at.items() if name.startswith("Ds")))


def onset_shift(model: RotorModel, theta: Float, onset: Threshold, term: LeftOut) -> float:
    """Change of the threshold speed by one unit of a left-out term, rad/s, the parameters held."""
    s = 1j * onset.whirl_frequency
    by_term = eigenvalue_shift(model, model.motion(theta, onset.speed), onset.speed, np.asarray(s), [term])[0]
    by_speed, _ = eigenvalue_gradient(model, theta, onset.speed, s)
    return float(-by_term.real / by_speed.real)


def eigenvalue_shift(
    model: RotorModel, coefficients: ComplexArray, speed: float, s: ComplexArray, terms: Sequence[LeftOut]
) -> ComplexArray:
    """Change of eigenvalues by one unit of left-out terms, 1/s, shape ``(..., T)``."""
    left, right, slope = mode_vectors(coefficients, s)
    at = seats(model)
    pressed = [
        sum(weight * left[..., at[i]] * right[..., at[j]] for i, j, weight in term.entries)
        * term.factor(s, np.asarray(speed))
        for term in terms
    ]
    return np.asarray(-np.stack(pressed, axis=-1) / slope[..., None])


def eigenvalues_with(
    model: RotorModel, coefficients: ComplexArray, speed: float, s: ComplexArray, terms: Sequence[LeftOut], sizes: Float
) -> ComplexArray:
    """Eigenvalues with left-out terms, shape ``(W, m)``, in no order. To first order in the terms, as of modes that may
    be close to one another: where two nearly coincide, the change of each by itself (:func:`eigenvalue_shift`) has no
    limit, while the terms mix both and move them by little."""
    left, right, slope = mode_vectors(coefficients[:, None], s)
    at = seats(model)
    pressed = np.zeros((*s.shape, s.shape[-1]), dtype=complex)
    for term, size in zip(terms, sizes.T, strict=True):
        factor = size[:, None] * term.factor(s, np.asarray(speed))
        for i, j, weight in term.entries:
            pressed += weight * left[..., at[i], None] * (factor * right[..., at[j]])[:, None, :]
    mixed = s[..., None] * np.eye(s.shape[-1]) - pressed / slope[..., None]
    return np.asarray(np.linalg.eigvals(mixed))
