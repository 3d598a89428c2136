"""Turning coordinates: a rotor whose stiffness turns with the shaft, seen by an observer who turns along.

In fixed coordinates ``kappa(d/dt) z + Delta exp(2j Om t) conj(z) = F`` has coefficients that change with time. With
``z = zeta exp(j Om t)`` they are constant, at the price of twice the coordinates, ``(zeta, conj(zeta))``: a force at w
makes motion at w and at the image 2 Om - w, exactly and no other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from math import comb
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.names import unknown_name
from rotorfit.models.coefficients import CoefficientJacobian
from rotorfit.models.complexes import Complex, J, Number
from rotorfit.models.model import Coordinate, Matrix, RotorModel
from rotorfit.models.orthotropic import shaft_apart
from rotorfit.models.parameters import Parameter
from rotorfit.models.shafts.angular_rates import angular_rate
from rotorfit.models.shafts.shaft import KnownStiffness

Line = tuple[int, bool]
"""k, and whether the line is an image: frequency w + 2k Om, of an image -w + 2k Om."""

IMAGE = "*"
"""Suffix of a plane's name in the name of its image's coordinate."""


class TurningFrame(RotorModel):
    """A model in turning coordinates; its eigenvalues are the Floquet exponents of the model itself.

    Coordinates are zeta of each plane, then conj(zeta) of each (named ``disk`` and ``disk*``). A motion ``A exp(jwt)``
    with its image ``B exp(j(2 Om - w)t)`` is the vector ``(A, conj(B))`` at the frequency w - Om. On supports that
    differ in two directions and stand still the other lines of the chain follow, as many as the model takes into
    account.

    Args:
        base: model in complex coordinates with a ``turning_stiffness``.

    Raises:
        ValueError: the model keeps x and y apart.
    """

    name: ClassVar[str] = "turning-frame"

    def __init__(self, base: RotorModel) -> None:
        if base.frame != "z":
            raise ValueError(f"{base.name} keeps x and y apart; turning coordinates need complex ones, z = x + jy")
        self.base, self.shaft = base, base.shaft
        self.lines = chain(base.line_count // 2 - 1)
        self.planes = tuple(plane + _suffix(line) for line in self.lines for plane in base.planes)
        self.parameters = base.parameters

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Those of the model, line after line."""
        own = self.base.coordinates
        return tuple(Coordinate(c.plane + _suffix(line), c.axis) for line in self.lines for c in own)

    def with_more_lines(self, count: int) -> TurningFrame | None:
        """See :meth:`RotorModel.with_more_lines`."""
        more = self.base.with_more_lines(count)
        return None if more is None else TurningFrame(more)

    def probe_factors(self, p: Any) -> Sequence[Number]:
        """A probe's factor, conjugated for images."""
        own = [Complex.of(factor) for factor in self.base.probe_factors(p)]
        return [factor.conj() if image else factor for _, image in self.lines for factor in own]

    def known_stiffness(self, theta: Float, s: ComplexArray, speed: Float) -> KnownStiffness:
        """A known structure at ``s + j Om`` and, conjugated, at ``conj(s) + j Om`` for the image."""
        shift = 1j * np.asarray(speed)
        ahead = self.base.known_stiffness(theta, s + shift, speed)
        behind = self.base.known_stiffness(theta, np.conj(s) + shift, speed)
        return KnownStiffness(
            beside([ahead.values, behind.values.conj()]), ahead.inputs, beside([ahead.slopes, behind.slopes.conj()])
        )

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """Powers of ``s = j (w - Om)``: the rotor at each line, ``sum C_k (s + j Om)^k`` at w and ``sum conj(C_k) (s -
        j Om)^k`` for its image, and what couples neighbours in the chain."""
        powers = [Complex.matrix(m) for m in self.base.equation(p, speed, eccentricity)]
        delta, still = Complex.matrix(self.base.turning_stiffness(p)), self.base.support_coupling(p)
        nothing = delta * 0.0
        powers += [nothing] * (len(still) - len(powers))
        rows: list[list[list[Complex]]] = [[[nothing] * len(self.lines) for _ in self.lines] for _ in powers]
        for i, (k, image) in enumerate(self.lines):
            turns = 2 * k - 1 if image else 2 * k + 1  # multiple of Om beyond +-(w - Om)
            shift = J * (turns * speed) * (-1.0 if image else 1.0)
            # the rate of a neighbour's conjugate is that of this line itself
            for other, pull in (((k, image), powers), ((1 - k, not image), [delta]), ((-k, not image), still)):
                if other in self.lines:
                    parts = shifted([m.conj() for m in pull] if image else pull, shift)
                    for power, matrix in enumerate(parts):
                        rows[power][i][self.lines.index(other)] = matrix
        return [Complex.block(block) for block in rows]


def chain(terms: int) -> tuple[Line, ...]:
    """Lines w and 2 Om - w, then their neighbours to either side in turn."""
    # w is followed on its other side by -w, w + 2 Om, -w - 2 Om, w + 4 Om, ...
    left = [(-(i // 2), True) if i % 2 == 0 else ((i + 1) // 2, False) for i in range(terms)]
    right = [(-(i // 2) - 1, False) if i % 2 == 0 else ((i + 1) // 2 + 1, True) for i in range(terms)]
    return ((0, False), (1, True), *(line for pair in zip(left, right, strict=True) for line in pair))


def _suffix(line: Line) -> str:
    """Suffixes of a plane's name in those of a line's coordinates."""
    if line in ((0, False), (1, True)):
        return IMAGE if line[1] else ""
    return f" {'-' if line[1] else ''}w{2 * line[0]:+d}Om"


def beside(parts: Sequence[ComplexArray]) -> ComplexArray:
    """Square matrices of one size along the diagonal of larger ones."""
    n, count = parts[0].shape[-1], len(parts)
    whole = np.zeros((*parts[0].shape[:-2], n * count, n * count), dtype=complex)
    for i, part in enumerate(parts):
        whole[..., i * n : (i + 1) * n, i * n : (i + 1) * n] = part
    return whole


def shifted(powers: Sequence[Complex], shift: Complex) -> list[Complex]:
    """Coefficients of ``sum C_k (s + shift)^k`` by powers of s."""
    result = []
    for low in range(len(powers)):
        total = powers[low]
        factor = Complex(1.0)
        for k in range(low + 1, len(powers)):
            factor = factor * shift
            total = total + powers[k] * (factor * float(comb(k, low)))
        result.append(total)
    return result


def shares_of_powers(count: int, shift: ComplexArray) -> ComplexArray:
    """Share that each C_k has in the coefficient of s^low in ``sum C_k (s + shift)^k``, shape ``(..., low, k)``."""
    orders = np.arange(count)
    binomials = np.array([[comb(k, low) for k in range(count)] for low in range(count)])  # zero for k below low
    return np.asarray(binomials * shift[..., None, None] ** np.maximum(orders - orders[:, None], 0))


def shifted_sides(coefficients: ComplexArray, shift: ComplexArray) -> ComplexArray:
    """Coefficients ``(..., order + 1, n, n)`` of motion as functions of s less a shift, beside those of its image."""
    sides = ((coefficients, shift), (coefficients.conj(), shift.conj()))
    shares = [shares_of_powers(coefficients.shape[-3], by) for _, by in sides]
    parts = [np.einsum("...lk,...kij->...lij", share, C) for share, (C, _) in zip(shares, sides, strict=True)]
    return beside(parts)


def unstable_bands(model: RotorModel, theta: ArrayLike, max_speed: float) -> list[tuple[float, float]]:
    """Ranges of rotative speed in which a shaft that is not round runs away (divergence in turning coordinates).

    The edges are the zeros of the determinant of the stiffness that a motion at rest in turning coordinates meets,
    ``|kappa(Om)|^2 - dK^2`` for one disk; without damping ``sqrt((K -+ dK)/M)``.

    Args:
        model: model in complex coordinates with a ``turning_stiffness``.
        theta: parameter vector, shape ``(P,)``.
        max_speed: highest speed searched, rad/s.

    Returns:
        lower and upper edge of each band, rad/s, ascending; the last may end at ``max_speed``.

    Raises:
        ValueError: no positive speed to search up to.
    """
    from scipy.optimize import brentq, minimize_scalar

    max_speed = angular_rate(max_speed, "max_speed", positive=True)
    frame = TurningFrame(model)
    values = np.asarray(theta, dtype=float)

    def determinant(speed: float) -> float:
        """Real, because the image's rows are the conjugates of the others."""
        kappa = frame.dynamic_stiffness(values, 0.0, speed)
        return float(np.linalg.det(kappa / np.abs(kappa).max()).real)

    count = 400  # speeds searched; a band that fits between two of them is found by the dip that it leaves
    speeds = [0.0, *np.linspace(0.0, max_speed, count)[1:].tolist()]
    heights = [determinant(v) for v in speeds]
    for i in range(count - 2, 0, -1):
        here = heights[i]
        if 0 < here <= min(heights[i - 1], heights[i + 1]):
            dip = minimize_scalar(
                determinant,
                bounds=(speeds[i - 1], speeds[i + 1]),
                method="bounded",
                options={"xatol": 1e-9 * max_speed},
            )
            if dip.fun < 0:
                at = i if dip.x < speeds[i] else i + 1
                speeds.insert(at, float(dip.x))
                heights.insert(at, float(dip.fun))
    edges = [
        float(brentq(determinant, low, high, xtol=1e-13 * max_speed, rtol=1e-14))
        for low, high, a, b in zip(speeds, speeds[1:], heights, heights[1:], strict=False)
        if a * b < 0
    ]
    if heights[0] < 0:
        edges.insert(0, 0.0)
    if len(edges) % 2:
        edges.append(max_speed)
    return list(zip(edges[::2], edges[1::2], strict=True))


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
        self.caveats = base.caveats
        self.in_band_only = base.in_band_only
        self.shaft = shaft_apart(base)
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
    def round_rotor(self) -> RotorModel:
        """The model."""
        return self.base

    @property
    def line_places(self) -> dict[str, int]:
        """See :attr:`RotorModel.line_places`."""
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
        total = shifted_sides(given, 1j * np.asarray(speed, dtype=float))
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
        parts: list[CoefficientJacobian] = []
        turn = np.asarray(1j * float(np.asarray(speed)))
        turned, powers = shifted_sides(whole, turn), np.arange(1, len(whole))
        for image in (0, size):
            place = np.arange(size) + image
            values = found.values.conj() if image else found.values
            moved = shares_of_powers(len(whole), turn.conj() if image else turn)[:, found.powers] * values
            low, entry = np.nonzero(moved)
            parts.append(
                replace(found.select(entry, place), inputs=inputs[entry], powers=low, values=moved[low, entry])
            )
            # By the speed of the coordinates themselves: d/ds of the polynomial, times that of the shift.
            slope = (-1j if image else 1j) * powers[:, None, None] * turned[1:, place[:, None], place]
            everything = CoefficientJacobian.of(len(self.parameters), slope)
            parts.append(everything.select(np.arange(everything.inputs.size), place))
        own = self.turning.functions.jacobian(theta, speed)
        mine = (own.inputs >= last) & (own.inputs < len(self.parameters))
        return CoefficientJacobian.joined([*parts, own.select(mine, self.shaft.at)])
