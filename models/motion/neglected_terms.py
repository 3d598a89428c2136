"""Terms that the equation of motion of a model may lack, as additions to its dynamic stiffness at the planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.models.model import RotorModel
from rotorfit.models.motion.stability import Threshold, eigenvalue_gradient, mode_vectors, seats
from rotorfit.models.structure import BLOCK_TABLE, Terms

Entries = tuple[tuple[int, int, float], ...]


@dataclass(frozen=True)
class LeftOut:
    """A term ``t sum(factor s^k Om^m) E`` that adds to kappa, linear in its size t."""

    name: str  # symbol and planes
    meaning: str  # in words
    unit: str  # SI unit of its size
    entries: Entries  # row, column and factor of each nonzero of E
    terms: Terms

    def factor(self, s: ComplexArray, speed: Float) -> ComplexArray:
        """Factor of E, broadcasting."""
        return np.asarray(sum(factor * speed**m * s**k for factor, k, m in self.terms), dtype=complex)


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
            both: Entries = ((i, i, 1.0),) if i == j else ((i, j, 1.0), (j, i, 1.0))
            where = f"[{first}]" if i == j else f"[{first}, {planes[j]}]"
            spring = ((i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0))
            kinds: list[tuple[str, str, Entries]] = [("gyroscopic", "gyroscopic effect", both)]
            if i != j:
                kinds = [
                    ("coupling_mass", "coupling mass", both),
                    ("coupling_damping", "coupling damping", both),
                    ("internal_damping", _INTERNAL, spring),
                    *kinds,
                ]
            found += [_of_block(block, meaning, where, e) for block, meaning, e in kinds if block not in blocks]
            if len(planes) > 1:
                found += [_beyond(*expansion, blocks, where, both) for expansion in _BEYOND]
    if len(planes) == 1 and "Ds" in model.parameter_names:
        found.append(_of_block("internal_damping", _INTERNAL, f"[{planes[0]}]", ((0, 0, 1.0),)))
    fluid, external = _damping_coordinates(model)
    for i in sorted(fluid - external):
        meaning = "external damping beside the fluid's, counted in D and lam"
        found.append(LeftOut(f"Ds[{planes[i]}]", meaning, "N s/m", ((i, i, 1.0),), ((1.0, 1, 0),)))
    return tuple(found)


_INTERNAL = "internal damping of the shaft"


def _of_block(block: str, meaning: str, where: str, entries: Entries) -> LeftOut:
    own = BLOCK_TABLE[block]
    return LeftOut(own.symbol + where, meaning, own.unit, entries, own.terms)


_BEYOND: tuple[tuple[str, tuple[str, ...], tuple[str, ...]], ...] = (
    ("gyroscopic effect", ("gyroscopic_out_of_band",), ("kg s^2", "kg s^4")),
    ("gyroscopic effect squared", ("gyroscopic_squared",), ("kg s^2", "kg s^4")),
    ("damping that changes with frequency", ("damping_out_of_band",), ("kg s", "kg s^3")),
    ("modes above the band", ("out_of_band", "next_out_of_band"), ("kg s^2", "kg s^4", "kg s^6")),
)
"""Expansions in the square of the frequency: meaning, structural blocks that hold the first terms in order, and units.
Symbols of terms after the first have their power in them."""


def _beyond(
    meaning: str, held: Sequence[str], units: Sequence[str], blocks: Sequence[str], where: str, entries: Entries
) -> LeftOut:
    """The first term of an expansion that a model lacks."""
    ((factor, first, speed),) = BLOCK_TABLE[held[0]].terms
    order = next((k for k, block in enumerate(held) if block not in blocks), len(held))
    power = first + 2 * order
    name = f"{BLOCK_TABLE[held[0]].symbol}{power if order else ''}{where}"
    turned = factor * (-1) ** order if speed == 1 else factor
    meaning = f"{meaning}, w^{power}{' Om^2' if speed == 2 else ''}"
    return LeftOut(name, meaning, units[order], entries, ((turned, power, speed),))


def fluid_endings(model: RotorModel) -> tuple[str, ...]:
    """Endings of the names of the fluids' parameters: none where there is one fluid."""
    return tuple(fluid.ending for fluid in model.fluids) or ("",)


def fluid_coordinates(model: RotorModel) -> list[int]:
    """Coordinates at which fluid damping D acts."""
    return sorted(_damping_coordinates(model)[0])


def dampings(model: RotorModel) -> dict[int, tuple[str, ...]]:
    """Names of the parameters that damp each coordinate by themselves, as far as any does."""
    functions, names = model.functions, model.parameter_names
    own = (functions.powers == 1) & (functions.rows == functions.columns) & (functions.inputs < len(names))
    found: dict[int, tuple[str, ...]] = {}
    for row, place in zip(functions.rows[own].tolist(), functions.inputs[own].tolist(), strict=True):
        found[row] = (*found.get(row, ()), names[place])
    return found


def _damping_coordinates(model: RotorModel) -> tuple[set[int], set[int]]:
    """Coordinates at which fluid damping D acts, and those with external damping."""
    own = {f"D{ending}" for ending in fluid_endings(model)}
    if not own <= set(model.parameter_names):
        return set(), set()
    at = dampings(model).items()
    external = {i for i, damping in at if any(name.startswith("Ds") for name in damping)}
    return {i for i, damping in at if own & set(damping)}, external


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
    model: RotorModel, coefficients: ComplexArray, speed: float, s: ComplexArray, terms: Sequence[tuple[LeftOut, Float]]
) -> ComplexArray:
    """Eigenvalues with left-out terms, given with their sizes ``(W,)``; shape ``(W, m)``, in no order. To first order
    in the terms, as of modes that may be close to one another: where two nearly coincide, the change of each by itself
    (:func:`eigenvalue_shift`) has no limit, while the terms mix both and move them by little."""
    left, right, slope = mode_vectors(coefficients[:, None], s)
    at = seats(model)
    pressed = np.zeros((*s.shape, s.shape[-1]), dtype=complex)
    for term, size in terms:
        factor = size[:, None] * term.factor(s, np.asarray(speed))
        for i, j, weight in term.entries:
            pressed += weight * left[..., at[i], None] * (factor * right[..., at[j]])[:, None, :]
    mixed = s[..., None] * np.eye(s.shape[-1]) - pressed / slope[..., None]
    return np.asarray(np.linalg.eigvals(mixed))
