"""Supports whose stiffness and damping differ in two directions, under any rotor that is itself round.

In complex coordinates such a support adds ``d exp(2jh) conj(z)`` to the force: it couples a motion at w with one at -w,
so x and y have to be kept apart. A round rotor's coefficient ``a + jb`` of z is the block ``[[a, -b], [b, a]]`` of x
and y; the support adds ``d [[cos 2h, sin 2h], [sin 2h, -cos 2h]]``, which no round rotor has. The condensed stiffness
of a known structure is ``kappa(s) = a(s) + j b(s)`` too; a and b follow from kappa at s and at its conjugate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar, Literal, Self

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.base.names import unknown_name
from rotorfit.models.coefficients import CoefficientJacobian
from rotorfit.models.complexes import Complex, Number
from rotorfit.models.model import Matrix, RotorModel
from rotorfit.models.parameters import Parameter
from rotorfit.models.shafts.shaft import KnownStiffness, ShaftApart


class Orthotropic(RotorModel):
    """A rotor of complex coordinates on supports that differ in two directions.

    Parameters are those of the rotor, whose support stiffness and damping are the means of both directions, and for
    each support ``dKs = K_1 - K_2`` and ``dDs = D_1 - D_2``, along and across a direction at the angle ``angle_s`` from
    x, which is known to be 0 unless freed: then ``dKs`` is the stiffness in x minus that in y.

    Args:
        base: the rotor, for instance ``rf.models.WhirlWhip()``.
        at: planes with such a support, by default the last of the rotor's.

    Raises:
        ValueError: a rotor with tilts, with a law of eccentricity, with complex probe factors, or one that keeps x and
            y apart already; a plane that the rotor does not have.

    Example:
        >>> model = rf.models.Orthotropic(rf.models.WhirlWhip(), at="journal")
        >>> model.parameter_names[-3:]
        ('dKs', 'dDs', 'angle_s')
    """

    name: ClassVar[str] = "orthotropic"
    frame: Literal["z", "xy"] = "xy"

    def __init__(self, base: RotorModel, at: str | Sequence[str] = ()) -> None:
        self.base = base
        self._check()
        self.planes = base.planes
        self.at = support_planes(at, base)
        self.caveats = base.caveats
        self.in_band_only = base.in_band_only
        self.magnetic = base.magnetic
        own = support_parameters(self.at)
        taken = {parameter.name for parameter in own} & set(base.parameter_names)
        if taken:
            raise ValueError(f"{base.name} has parameters of its own called {', '.join(sorted(taken))}")
        self.parameters = (*base.parameters, *own)
        self.shaft = shaft_apart(base)

    def _check(self) -> None:
        base = self.base
        if base.frame != "z":
            raise ValueError(f"{base.name} keeps x and y apart already")
        if any(coordinate.axis != "z" for coordinate in base.coordinates):
            raise ValueError(f"{base.name} has tilts, whose supports are not modelled in two directions")
        if base.eccentricity_dependent:
            raise ValueError(f"{base.name} has a law of eccentricity; orbits on an orthotropic support are not circles")
        if base.turns:
            raise ValueError(
                f"{base.name} has a stiffness that turns, which with supports that do not makes many lines: "
                "rf.models.TurningOnSupports(Turning(...)) has them"
            )
        if any(not ca.SX(factor.im).is_zero() for factor in base.symbolic[4]):
            raise ValueError(f"{base.name} has complex probe factors, which turn x into y")

    @property
    def on_own_supports(self) -> RotorModel:
        """The rotor on its own supports."""
        return self.base

    @property
    def blocks(self) -> tuple[str, ...]:
        """Structural blocks of the rotor.

        Raises:
            AttributeError: a rotor of one plane has none.
        """
        found: tuple[str, ...] = self.base.blocks  # type: ignore[attr-defined]
        return found

    def variant(self, **changes: Any) -> Self:
        """The same model with other options, its own or those of the rotor.

        Args:
            **changes: ``base``, ``at``, or options of the rotor such as ``blocks``.

        Raises:
            ValueError: neither has such an option.
        """
        own = {name: changes.pop(name) for name in ("base", "at") if name in changes}
        base = own.get("base", self.base)
        if "planes" in changes and "at" not in own:
            own["at"] = tuple(changes["planes"][self.planes.index(plane)] for plane in self.at)
        return type(self)(base.variant(**changes) if changes else base, own.get("at", self.at))

    def probe_factors(self, p: Any) -> Sequence[Number]:
        """See :meth:`RotorModel.probe_factors`."""
        factors = list(self.base.probe_factors(p))
        return [*factors, *factors]

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """See :meth:`RotorModel.equation`."""
        powers = []  # the real matrices for x and y of the complex ones for z = x + jy
        for matrix in map(Complex.matrix, self.base.equation(p, speed, 0.0)):
            powers.append(Complex(ca.vertcat(ca.horzcat(matrix.re, -matrix.im), ca.horzcat(matrix.im, matrix.re))))
        while len(powers) < 2:
            powers.append(powers[0] * 0.0)
        count = len(self.planes)
        for i, plane in enumerate(self.at):
            node = self.base.planes.index(plane)
            angle = getattr(p, support_symbol("angle_s", i, self.at))
            for power, kind in ((0, "dKs"), (1, "dDs")):
                half = 0.5 * getattr(p, support_symbol(kind, i, self.at))
                straight, cross = half * ca.cos(2 * angle), half * ca.sin(2 * angle)
                addition = ca.SX(2 * count, 2 * count)
                addition[node, node], addition[node + count, node + count] = straight, -straight
                addition[node, node + count] = addition[node + count, node] = cross
                powers[power] = powers[power] + Complex(addition)
        return powers

    # ---- a known structure ------------------------------------------------------------------------------------------

    def _round(self, theta: ArrayLike) -> Float:
        """Parameters of the rotor itself."""
        return np.asarray(theta, dtype=float)[..., : len(self.base.parameters)]

    def known_stiffness(self, theta: Float, s: ComplexArray, speed: Float) -> KnownStiffness:
        """See :meth:`RotorModel.known_stiffness`."""
        ahead = self.base.known_stiffness(self._round(theta), s, speed)
        behind = self.base.known_stiffness(self._round(theta), s.conj(), speed)
        values = _numbers_apart(ahead.values, behind.values.conj())
        return KnownStiffness(values, ahead.inputs, _numbers_apart(ahead.slopes, behind.slopes.conj()))

    def motion(self, theta: ArrayLike, speed: ArrayLike) -> ComplexArray:
        """See :meth:`RotorModel.motion`: of a known structure x of all its coordinates, then y."""
        if self.shaft is None:
            return self.coefficients(theta, speed)
        whole = self.base.motion(self._round(theta), speed)
        own = self.base.coefficients(self._round(theta), speed)
        support = self.coefficients(theta, speed) - _numbers_apart(own, own.conj())
        shape = np.broadcast_shapes(whole.shape[:-2], support.shape[:-2])
        total = _numbers_apart(whole, whole.conj())
        total = np.array(np.broadcast_to(total, (*shape, *total.shape[-2:])))
        total[..., self.shaft.at[:, None], self.shaft.at] += support
        return total

    def motion_jacobian(self, theta: ArrayLike, speed: ArrayLike) -> CoefficientJacobian:
        """See :meth:`RotorModel.motion_jacobian`."""
        added = self.functions.jacobian(theta, speed)
        if self.shaft is None:
            return added
        count = len(self.base.parameters)
        given = self.base.motion_jacobian(self._round(theta), speed)
        half = self.base.motion(self._round(theta), speed).shape[-1]
        inputs = np.where(given.inputs >= count, given.inputs + len(self.parameters) - count, given.inputs)
        own = (added.inputs >= count) & (added.inputs < len(self.parameters))
        rows, columns = given.rows, given.columns
        real, imaginary = given.values.real.astype(complex), given.values.imag.astype(complex)
        parts = [
            replace(given, inputs=inputs, rows=rows + below * half, columns=columns + right * half, values=values)
            for below, right, values in ((0, 0, real), (1, 1, real), (0, 1, -imaginary), (1, 0, imaginary))
        ]
        return CoefficientJacobian.joined([*parts, added.select(own, self.shaft.at)])


def _numbers_apart(ahead: ComplexArray, behind: ComplexArray) -> ComplexArray:
    """Matrices for x and y, shape ``(..., 2n, 2n)``, of those for z at s and, conjugated, at the conjugate of s."""
    even, odd = (ahead + behind) / 2, (ahead - behind) / 2j
    top = np.concatenate([even, -odd], axis=-1)
    return np.concatenate([top, np.concatenate([odd, even], axis=-1)], axis=-2)


def shaft_apart(base: RotorModel) -> ShaftApart | None:
    """The structure of a rotor, if it has one, with x and y, or coordinates and their images, apart."""
    if base.shaft is None:
        return None
    size = base.motion(np.ones(len(base.parameters)), 0.0).shape[-1]
    return ShaftApart(at=np.concatenate([base.shaft.at, base.shaft.at + size]), has_mass=base.shaft.has_mass)


def support_planes(at: str | Sequence[str], base: RotorModel) -> tuple[str, ...]:
    """Planes of a rotor on supports that differ in two directions, by default its last one."""
    chosen = ((at,) if isinstance(at, str) else tuple(at)) or base.planes[-1:]
    for plane in chosen:
        if plane not in base.planes:
            raise ValueError(unknown_name(f"plane of {base.name}", plane, base.planes))
    if len(set(chosen)) < len(chosen):
        raise ValueError(f"at names a plane twice: {', '.join(chosen)}")
    return chosen


def support_symbol(kind: str, support: int, at: Sequence[str]) -> str:
    """Name of a support's parameter: numbered where there are several supports."""
    return kind if len(at) == 1 else f"{kind}_{support + 1}"


def support_parameters(at: Sequence[str]) -> list[Parameter]:
    """Parameters of supports that differ in two directions."""
    kinds = (
        ("dKs", "N/m", "support stiffness along its direction minus across", 5e3, None),
        ("dDs", "N s/m", "support damping along its direction minus across", 10.0, None),
        ("angle_s", "rad", "direction of the support from x", 0.5, 0.0),
    )
    return [
        Parameter(support_symbol(kind, i, at), unit, f"{meaning}, {plane}", scale=scale, default=default)
        for i, plane in enumerate(at)
        for kind, unit, meaning, scale, default in kinds
    ]
