"""Supports whose stiffness and damping differ in two directions, under any rotor that is itself round.

In complex coordinates such a support adds ``d exp(2jh) conj(z)`` to the force: it couples a motion at w with one at -w,
so x and y have to be kept apart. A round rotor's coefficient ``a + jb`` of z is the block ``[[a, -b], [b, a]]`` of x
and y; the support adds ``d [[cos 2h, sin 2h], [sin 2h, -cos 2h]]``, which no round rotor has.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, Literal, Self

import casadi as ca

from rotorfit.models.complexes import Complex, Number
from rotorfit.models.model import Matrix, RotorModel
from rotorfit.models.parameters import Parameter, unknown_name


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
        self.at = ((at,) if isinstance(at, str) else tuple(at)) or base.planes[-1:]
        for plane in self.at:
            if plane not in base.planes:
                raise ValueError(unknown_name(f"plane of {base.name}", plane, base.planes))
        if len(set(self.at)) < len(self.at):
            raise ValueError(f"at names a plane twice: {', '.join(self.at)}")
        self.caveats = base.caveats
        own = [parameter for i, plane in enumerate(self.at) for parameter in self._support(i, plane)]
        taken = {parameter.name for parameter in own} & set(base.parameter_names)
        if taken:
            raise ValueError(f"{base.name} has parameters of its own called {', '.join(sorted(taken))}")
        self.parameters = (*base.parameters, *own)

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
                "rf.models.harmonic_set predicts them"
            )
        if base.shaft is not None:
            raise ValueError(f"{base.name} has a known structure, which is condensed in complex coordinates only")
        if any(not ca.SX(factor.im).is_zero() for factor in base.symbolic[4]):
            raise ValueError(f"{base.name} has complex probe factors, which turn x into y")

    def _symbol(self, kind: str, support: int) -> str:
        return kind if len(self.at) == 1 else f"{kind}_{support + 1}"

    def _support(self, i: int, plane: str) -> tuple[Parameter, ...]:
        return (
            Parameter(
                self._symbol("dKs", i), "N/m", f"support stiffness along its direction minus across, {plane}", scale=5e3
            ),
            Parameter(
                self._symbol("dDs", i),
                "N s/m",
                f"support damping along its direction minus across, {plane}",
                scale=10.0,
            ),
            Parameter(
                self._symbol("angle_s", i), "rad", f"direction of the support from x, {plane}", scale=0.5, default=0.0
            ),
        )

    @property
    def blocks(self) -> tuple[str, ...]:
        """Structural blocks of the rotor.

        Raises:
            AttributeError: a rotor of one plane has none.
        """
        found: tuple[str, ...] = self.base.blocks  # type: ignore[attr-defined]
        return found

    def options(self) -> dict[str, Any]:
        """See :meth:`RotorModel.options`."""
        return {"base": self.base, "at": self.at}

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
        given = self.base.equation(p, speed, 0.0)
        powers = [_apart(m if isinstance(m, Complex) else Complex.matrix(m)) for m in given]
        while len(powers) < 2:
            powers.append(powers[0] * 0.0)
        count = len(self.planes)
        for i, plane in enumerate(self.at):
            node = self.base.planes.index(plane)
            angle = getattr(p, self._symbol("angle_s", i))
            for power, kind in ((0, "dKs"), (1, "dDs")):
                half = 0.5 * getattr(p, self._symbol(kind, i))
                straight, cross = half * ca.cos(2 * angle), half * ca.sin(2 * angle)
                addition = ca.SX(2 * count, 2 * count)
                addition[node, node], addition[node + count, node + count] = straight, -straight
                addition[node, node + count] = addition[node + count, node] = cross
                powers[power] = powers[power] + Complex(addition)
        return powers


def _apart(matrix: Complex) -> Complex:
    """The real matrix for x and y of a complex one for z = x + jy."""
    return Complex(ca.vertcat(ca.horzcat(matrix.re, -matrix.im), ca.horzcat(matrix.im, matrix.re)))
