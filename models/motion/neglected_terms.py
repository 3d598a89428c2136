"""Terms that the equation of motion of a model may lack, as additions to its dynamic stiffness at the planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.model import RotorModel
from rotorfit.models.motion.stability import Threshold, eigenvalue_gradient, mode_vectors, seats


@dataclass(frozen=True, kw_only=True)
class LeftOut:
    """A term ``t (a + b Om + c Om^2) s^k E`` that adds to kappa, linear in its size t."""

    name: str  # symbol and planes
    meaning: str  # in words
    unit: str  # SI unit of its size
    entries: tuple[tuple[int, int, float], ...]  # row, column and factor of each nonzero of E
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
                found.append(_term("m", where, "coupling mass", "kg", both, 2))
            if i != j and "coupling_damping" not in blocks:
                found.append(_term("c", where, "coupling damping", "N s/m", both, 1))
            if i != j and "internal_damping" not in blocks:
                twist = ((i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0))
                internal = _term("ci", where, "internal damping of the shaft", "N s/m", twist, 1)
                found.append(_with(internal, more=((0, 0.0, -1j),)))
            if "gyroscopic" not in blocks:
                found.append(_term("g", where, "gyroscopic effect", "kg", both, 1, by_speed=-1j))
            if len(planes) > 1:
                found += [_beyond(expansion, blocks, where, both) for expansion in _BEYOND]
    if len(planes) == 1 and "Ds" in model.parameter_names:
        internal = _term("ci", f"[{planes[0]}]", "internal damping of the shaft", "N s/m", ((0, 0, 1.0),), 1)
        found.append(_with(internal, more=((0, 0.0, -1j),)))
    for i in externally_undamped(model):
        meaning = "external damping beside the fluid's, counted in D and lam"
        found.append(_term("Ds", f"[{planes[i]}]", meaning, "N s/m", ((i, i, 1.0),), 1))
    return tuple(found)


@dataclass(frozen=True, kw_only=True)
class _Expansion:
    """Terms of an expansion in the square of the frequency."""

    symbol: str  # of its terms; those after the first have their power in the symbol
    meaning: str
    blocks: tuple[str, ...]  # structural blocks that hold its first terms, in order
    power: int  # of the first
    units: tuple[str, ...]  # of the first and the next ones
    speed: int = 0  # power of the rotative speed


_BEYOND = (
    _Expansion(
        symbol="h", meaning="gyroscopic effect", blocks=("gyroscopic_out_of_band",), power=3,
        units=("kg s^2", "kg s^4"), speed=1,
    ),
    _Expansion(
        symbol="e", meaning="gyroscopic effect squared", blocks=("gyroscopic_squared",), power=2,
        units=("kg s^2", "kg s^4"), speed=2,
    ),
    _Expansion(
        symbol="d", meaning="damping that changes with frequency", blocks=("damping_out_of_band",), power=3,
        units=("kg s", "kg s^3"),
    ),
    _Expansion(
        symbol="q", meaning="modes above the band", blocks=("out_of_band", "next_out_of_band"), power=4,
        units=("kg s^2", "kg s^4", "kg s^6"),
    ),
)  # fmt: skip


def _beyond(
    expansion: _Expansion, blocks: Sequence[str], where: str, entries: tuple[tuple[int, int, float], ...]
) -> LeftOut:
    """The first term of an expansion that a model lacks."""
    order = next((k for k, block in enumerate(expansion.blocks) if block not in blocks), len(expansion.blocks))
    power = expansion.power + 2 * order
    name = f"{expansion.symbol}{power}" if order else expansion.symbol
    meaning = f"{expansion.meaning}, w^{power}{' Om^2' if expansion.speed == 2 else ''}"
    turning = 1j * (-1) ** order if expansion.speed == 1 else 0.0
    squared = 1.0 if expansion.speed == 2 else 0.0
    return _term(
        name, where, meaning, expansion.units[order], entries, power, by_speed=turning, by_speed_squared=squared
    )


def _term(
    symbol: str,
    where: str,
    meaning: str,
    unit: str,
    entries: tuple[tuple[int, int, float], ...],
    power: int,
    by_speed: complex = 0.0,
    by_speed_squared: float = 0.0,
) -> LeftOut:
    return LeftOut(
        name=symbol + where,
        meaning=meaning,
        unit=unit,
        entries=entries,
        power=power,
        constant=0.0 if by_speed or by_speed_squared else 1.0,
        by_speed=by_speed,
        by_speed_squared=by_speed_squared,
    )


def _with(term: LeftOut, *, more: tuple[tuple[int, complex, complex], ...]) -> LeftOut:
    return LeftOut(**{**term.__dict__, "more": more})


def fluid_coordinates(model: RotorModel) -> list[int]:
    """Coordinates at which fluid damping D acts."""
    return sorted(_damping_coordinates(model)[0])


def externally_undamped(model: RotorModel) -> list[int]:
    """Those of them without external damping of the model's own."""
    fluid, external = _damping_coordinates(model)
    return sorted(fluid - external)


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
