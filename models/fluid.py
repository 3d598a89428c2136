"""The fluid force of lightly loaded bearings and seals (eqs 11 to 13)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, NamedTuple

from rotorfit.models.complexes import Complex, J
from rotorfit.models.laws import Constant, Law, clearance_of
from rotorfit.models.parameters import Parameter


class FluidForce(NamedTuple):
    """Stiffness, damping and mass by which the fluid adds to a journal's dynamic stiffness, complex symbols.

    Attributes:
        K, C, M: factors of s^0, s^1 and s^2: N/m, N s/m, kg.
    """

    K: Complex
    C: Complex
    M: Complex


def fluid_force(K0: Any, D: Any, Mf: Any, lam_D: Any, lam_M: Any, speed: Any) -> FluidForce:
    """Fluid force of eq. (13), turning with the circumferential average velocity ratio.

    ``kappa_fluid = K0 + D (s - j lam_D Om) + Mf (s - j lam_M Om)^2`` with ``s = j w``, sorted by powers of s.
    Damping and inertia may turn at different ratios, as measured seals do; eq. (13) has ``lam_D = lam_M = lam``.

    Args:
        K0: radial stiffness, N/m.
        D: radial damping, N s/m.
        Mf: fluid inertia, kg.
        lam_D, lam_M: velocity ratios of damping and inertia.
        speed: rotative speed Omega, rad/s; all of these numbers or CasADi symbols.
    """
    whirl_D, whirl_M = J * (lam_D * speed), J * (lam_M * speed)
    return FluidForce(K=K0 - D * whirl_D + Mf * whirl_M * whirl_M, C=D - 2.0 * (Mf * whirl_M), M=Complex.of(Mf))


def fluid_parameters(two_lam: bool) -> tuple[Parameter, ...]:
    """K0, D, lam (or lam_D and lam_M) and Mf; K0 has no lower limit, as near stall the radial stiffness is negative."""
    ratio = "velocity ratio"
    apart = (("lam_D", f"{ratio} of the damping force"), ("lam_M", f"{ratio} of the inertia force"))
    lams = apart if two_lam else (("lam", f"fluid {ratio}"),)
    return (
        Parameter("K0", "N/m", "fluid radial stiffness", scale=1e4),
        Parameter("D", "N s/m", "fluid radial damping", scale=500.0),
        *(Parameter(name, "1", meaning, scale=0.5, lower=-2.0, upper=2.0) for name, meaning in lams),
        Parameter("Mf", "kg", "fluid inertia", scale=0.3),
    )


def fluid_at(law: Law, p: Any, two_lam: bool, speed: Any, eccentricity: Any) -> FluidForce:
    """Fluid force of eq. (13) with the coefficients that a law gives; one factor for both ratios."""
    fluid = law.at_speed(p, eccentricity, speed)
    lam_D, lam_M = (p.lam_D, p.lam_M) if two_lam else (p.lam, p.lam)
    return fluid_force(fluid.K0, fluid.D, p.Mf, lam_D * fluid.ratio, lam_M * fluid.ratio, speed)


@dataclass(frozen=True, kw_only=True)
class PlaneFluid:
    """Fluid force at a plane; the names of its parameters end with the plane where a rotor has several fluids.

    Attributes:
        plane: where it acts.
        law: how it changes with eccentricity, or with speed.
        two_lam: damping and inertia turn at ratios of their own.
        ending: what the names of its parameters end with.
    """

    plane: str
    law: Law
    two_lam: bool = False
    ending: str = ""

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Those of the force, then those of the law."""
        own = (*fluid_parameters(self.two_lam), *self.law.parameters)
        return tuple(replace(q, name=q.name + self.ending) for q in own)

    def own(self, p: Any) -> SimpleNamespace:
        """The fluid's parameters by their names without the ending.

        Args:
            p: the rotor's parameters by name, CasADi symbols.
        """
        names = [q.name for q in self.parameters]
        return SimpleNamespace(**{name.removesuffix(self.ending): getattr(p, name) for name in names})

    def force(self, p: Any, speed: Any, eccentricity: Any) -> FluidForce:
        """Force on the rotor.

        Args:
            p: the rotor's parameters by name, CasADi symbols.
            speed: rotative speed Omega, rad/s.
            eccentricity: orbit radius over clearance.
        """
        return fluid_at(self.law, self.own(p), self.two_lam, speed, eccentricity)

    def start(self, values: Mapping[str, float]) -> dict[str, float]:
        """Values of the law's parameters at which a fit may begin.

        Args:
            values: of K0 and D at eps = 0, by name.
        """
        begin = self.law.start(*(abs(values[name + self.ending]) for name in ("K0", "D")))
        return {name + self.ending: value for name, value in begin.items()}


Laws = Law | Mapping[str, Law] | Sequence[tuple[str, Law]]
"""One law for every fluid, or laws by plane."""


def fluids_of(
    fluid: str | Sequence[str] | None, law: Laws | None = None, *, two_lam: bool = False
) -> tuple[PlaneFluid, ...]:
    """Fluids of a rotor, one for each plane that is named.

    Args:
        fluid: plane, or planes.
        law: one for all, or by plane; none by default.
        two_lam: damping and inertia turn at ratios of their own.

    Raises:
        ValueError: a law without fluid.

    Example:
        >>> [q.name for q in rf.models.fluids_of(["bearing", "seal"])[1].parameters]
        ['K0_seal', 'D_seal', 'lam_seal', 'Mf_seal']
    """
    planes = () if fluid is None else (fluid,) if isinstance(fluid, str) else tuple(fluid)
    laws = dict.fromkeys(planes, law or Constant()) if law is None or isinstance(law, Law) else dict(law)
    beside = [plane for plane in laws if plane not in planes]
    if beside:
        raise ValueError(f"a law at {', '.join(beside)}, but the fluid acts at {', '.join(planes) or 'no plane'}")
    if isinstance(law, Law) and law.parameters and not planes:
        raise ValueError("a law needs a fluid: say at which plane it acts, fluid=...")
    return tuple(
        PlaneFluid(
            plane=plane,
            law=laws.get(plane, Constant()),
            two_lam=two_lam,
            ending=f"_{plane}" if len(planes) > 1 else "",
        )
        for plane in planes
    )


Clearances = float | Mapping[str, float] | Sequence[tuple[str, float]]
"""One radial clearance for every fluid, or clearances by plane, micrometres."""


Kept = float | tuple[tuple[str, float], ...] | None
"""Clearances as a model keeps them."""


def laws_and_clearances(
    fluids: Sequence[PlaneFluid], law: Laws | None, clearance_um: Clearances | None, model: str
) -> tuple[Law | tuple[tuple[str, Law], ...], Kept, Kept]:
    """Laws, clearances as given and in m, as a model keeps them, checked against its fluids."""
    kept = law if isinstance(law, Law) else Constant() if law is None else tuple(dict(law).items())
    if clearance_um is None or isinstance(clearance_um, int | float):
        of_orbit = next((fluid.law for fluid in fluids if fluid.law.of_eccentricity), Constant())
        return kept, clearance_um, clearance_of(of_orbit, clearance_um, model)
    gaps = dict(clearance_um)
    beside = [plane for plane in gaps if plane not in [fluid.plane for fluid in fluids]]
    if beside:
        raise ValueError(f"{model}: a clearance at {', '.join(beside)}, where no fluid acts")
    found = {
        fluid.plane: clearance_of(fluid.law, gaps.get(fluid.plane), f"{model} at {fluid.plane}") for fluid in fluids
    }
    known = tuple((plane, gap) for plane, gap in found.items() if gap is not None)
    return kept, tuple(gaps.items()), known
