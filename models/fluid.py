"""The fluid force of lightly loaded bearings and seals (eqs 11 to 13)."""

from __future__ import annotations

from typing import Any, NamedTuple

from rotorfit.models.complexes import Complex, J
from rotorfit.models.laws import Law
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
