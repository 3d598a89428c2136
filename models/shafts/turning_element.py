"""An element of a rotor with two stiffnesses that turn with it: a keyed or cracked piece of shaft in a lumped model."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from math import comb
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.models.complexes import Complex, Number
from rotorfit.models.model import CoefficientJacobian, Coordinate, Matrix, RotorModel
from rotorfit.models.parameters import Parameter, unknown_name
from rotorfit.models.shafts.shaft import KnownStiffness, ShaftApart
from rotorfit.models.shafts.turning import TurningFrame, beside


class Turning(RotorModel):
    """A model one of whose elements has two lateral stiffnesses that turn with it, dK more and dK less than the mean.

    Its parameters are those of the model, then ``dK_cos = dK cos 2g`` and ``dK_sin = dK sin 2g``, g the angle of the
    stiff direction ahead of the Keyphasor mark.

    Args:
        base: the model: one mode, whirl and whip, a chain, a known structure and others in complex coordinates.
        element: what the element is between: two planes, or one plane and the ground; by default the first plane and
            the ground.

    Raises:
        ValueError: a model in x and y or with a law of eccentricity, or planes that it does not have.
    """

    name: ClassVar[str] = "turning"
    turns = True

    def __init__(self, base: RotorModel, element: str | Sequence[str] | None = None) -> None:
        ends = (base.planes[0],) if element is None else (element,) if isinstance(element, str) else tuple(element)
        if base.frame != "z":
            raise ValueError(
                f"{base.name} keeps x and y apart; a turning element needs complex coordinates, z = x + jy"
            )
        if base.eccentricity_dependent:
            raise ValueError(f"{base.name} changes with eccentricity; a turning element needs a linear model, law=None")
        for plane in ends:
            if plane not in base.planes:
                raise ValueError(unknown_name(f"plane of {base.name}", plane, base.planes))
        if not 1 <= len(set(ends)) == len(ends) <= 2:
            raise ValueError(f"an element is between two planes, or a plane and the ground; got {', '.join(ends)}")
        self.base, self.element = base, ends
        self.planes, self.clearance = base.planes, base.clearance
        self.caveats, self.caveats_without_tilts = base.caveats, base.caveats_without_tilts
        self.in_band_only = base.in_band_only
        if base.shaft is not None:
            size = base.motion(np.ones(len(base.parameters)), 0.0).shape[-1]
            at = np.concatenate([base.shaft.at, base.shaft.at + size])
            self.shaft = ShaftApart(at=at, has_mass=base.shaft.has_mass)
        self.parameters = (
            *base.parameters,
            Parameter("dK_cos", "N/m", f"turning anisotropy, dK cos 2g, at {' to '.join(ends)}", scale=1e3),
            Parameter("dK_sin", "N/m", f"turning anisotropy, dK sin 2g, at {' to '.join(ends)}", scale=1e3),
        )

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Those of the model."""
        return self.base.coordinates

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """The round part: that of the model."""
        return self.base.equation(p, speed, eccentricity)

    def probe_factors(self, p: Any) -> Sequence[Number]:
        """See :meth:`RotorModel.probe_factors`."""
        return self.base.probe_factors(p)

    def turning_stiffness(self, p: Any) -> Matrix:
        """``dK exp(2jg)`` times the square of the element's stretch."""
        stretch = [0.0] * len(self.coordinates)
        for plane, sign in zip(self.element, (1.0, -1.0), strict=False):
            stretch[self.coordinate(plane, "z")] = sign
        delta = Complex(p.dK_cos, p.dK_sin)
        return [[delta * (a * b) for b in stretch] for a in stretch]

    @cached_property
    def turning(self) -> TurningFrame:
        """The equations in turning coordinates, where their coefficients are constant."""
        return TurningFrame(self)

    @property
    def line_places(self) -> dict[str, int]:
        """Lines that can be read, by name, with their place among those of :attr:`turning`."""
        return {"w": 0, "2Om-w": 1}

    @property
    def speed_dependent(self) -> bool:
        """In turning coordinates always."""
        return True

    def _round(self, theta: ArrayLike) -> Float:
        """Parameters of the round rotor."""
        return np.asarray(theta, dtype=float)[..., : len(self.base.parameters)]

    def known_stiffness(self, theta: Float, s: ComplexArray, speed: Float) -> KnownStiffness:
        """See :meth:`RotorModel.known_stiffness`."""
        return self.base.known_stiffness(self._round(theta), s, speed)

    def motion(self, theta: ArrayLike, speed: ArrayLike) -> ComplexArray:
        """Free motion in turning coordinates; of a known structure all its coordinates, then their images."""
        if self.shaft is None:
            return self.turning.coefficients(theta, speed)
        given = self.base.motion(self._round(theta), speed)
        Om = np.asarray(speed, dtype=float)[..., None, None]
        ahead, behind = (
            np.stack(_shifted_numbers(np.moveaxis(part, -3, 0), shift), axis=-3)
            for part, shift in ((given, 1j * Om), (given.conj(), -1j * Om))
        )
        total = beside([ahead, behind])
        own = self.turning.coefficients(theta, speed)
        n = len(self.coordinates)
        first, second = self.shaft.at[:n], self.shaft.at[n:]
        total[..., first[:, None], second] += own[..., :n, n:]
        total[..., second[:, None], first] += own[..., n:, :n]
        return total

    def motion_jacobian(self, theta: ArrayLike, speed: ArrayLike) -> CoefficientJacobian:
        """See :meth:`RotorModel.motion_jacobian`."""
        if self.shaft is None:
            return self.turning.motion_jacobian(theta, speed)
        found = self.base.motion_jacobian(self._round(theta), speed)
        whole = self.base.motion(self._round(theta), speed)
        last, size = len(self.base.parameters), whole.shape[-1]
        inputs = np.where(found.inputs >= last, found.inputs + len(self.parameters) - last, found.inputs)
        parts = []
        turn = 1j * float(np.asarray(speed))
        for image, shift in ((0, turn), (size, -turn)):
            values = found.values.conj() if image else found.values
            for low in range(len(whole)):
                rises = found.powers >= low
                share = [comb(k, low) * shift ** (k - low) if k >= low else 0.0 for k in range(len(whole))]
                moved = values[rises] * np.array(share)[found.powers[rises]]
                rows, columns = found.rows[rises] + image, found.columns[rises] + image
                parts.append((inputs[rises], np.full(moved.size, low), rows, columns, moved))
            matrices = whole.conj() if image else whole
            for low in range(len(whole) - 1):  # by the speed of the coordinates themselves
                slope = sum(
                    comb(k, low) * (k - low) * shift ** (k - low - 1) * (-1j if image else 1j) * matrices[k]
                    for k in range(low + 1, len(whole))
                )
                rows, columns = np.nonzero(slope)
                place = np.full(rows.size, len(self.parameters))
                parts.append((place, np.full(rows.size, low), rows + image, columns + image, slope[rows, columns]))
        own = self.turning.functions.jacobian(theta, speed)
        mine = (own.inputs >= last) & (own.inputs < len(self.parameters))
        at = self.shaft.at
        parts.append((own.inputs[mine], own.powers[mine], at[own.rows[mine]], at[own.columns[mine]], own.values[mine]))
        columns_of = [np.concatenate(column) for column in zip(*parts, strict=True)]
        names = ("inputs", "powers", "rows", "columns", "values")
        return CoefficientJacobian(**dict(zip(names, columns_of, strict=True)))


def _shifted_numbers(powers: ComplexArray, shift: ComplexArray) -> list[ComplexArray]:
    """Coefficients of ``sum C_k (s + shift)^k`` by powers of s, the powers first."""
    return [
        np.asarray(sum(comb(k, low) * shift ** (k - low) * powers[k] for k in range(low, len(powers))))
        for low in range(len(powers))
    ]
