"""Laws of eccentricity: how the fluid's stiffness, damping and velocity ratio change with the size of the orbit.

The eccentricity is ``eps = |z_b| / clearance``, z_b being the journal's displacement from the centre of the bearing
or seal. K0, D and lam keep their names and are the values at ``eps = 0``.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple

import casadi as ca

from rotorfit.base.digits import significant
from rotorfit.models.parameters import Parameter


class Fluid(NamedTuple):
    """Radial stiffness and damping at an eccentricity, and the factor on the velocity ratio; symbolic."""

    K0: Any  # N/m
    D: Any  # N s/m
    ratio: Any  # velocity ratio over that at eps = 0


class Law(ABC):
    """A law K0(eps), D(eps), lam(eps), or of the speed.

    Attributes:
        name: name for tables and files.
        of_eccentricity: whether it needs a clearance.
        parameters: what the law adds to a model's parameters.
    """

    name: ClassVar[str]
    of_eccentricity: ClassVar[bool] = True

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the law itself."""

    @abstractmethod
    def at(self, p: Any, eccentricity: Any) -> Fluid:
        """Fluid at an eccentricity.

        Args:
            p: all parameters by name, symbolic, K0 and D among them.
            eccentricity: eps, symbolic, 0 <= eps < 1.
        """

    def at_speed(self, p: Any, eccentricity: Any, speed: Any) -> Fluid:
        """Fluid at an eccentricity and a speed, that of :meth:`at` unless overridden.

        Args:
            p: all parameters by name, symbolic.
            eccentricity: eps, symbolic.
            speed: rotative speed, rad/s, symbolic.
        """
        return self.at(p, eccentricity)

    def start(self, K0: float, D: float) -> dict[str, float]:
        """Values from which a fit may begin, for given values at eps = 0: the parameters' scales unless overridden.

        Args:
            K0: stiffness at eps = 0, N/m.
            D: damping at eps = 0, N s/m.
        """
        return {q.name: min(max(q.scale, q.lower), q.upper) for q in self.parameters}


@dataclass(frozen=True)
class Constant(Law):
    """Linear fluid: nothing changes with eccentricity."""

    name: ClassVar[str] = "constant"
    of_eccentricity: ClassVar[bool] = False

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """See :attr:`Law.parameters`."""
        return ()

    def at(self, p: Any, eccentricity: Any) -> Fluid:
        """See :meth:`Law.at`."""
        return Fluid(p.K0, p.D, 1.0)


@dataclass(frozen=True)
class Muszynska(Law):
    """``K0 (1 - eps^2)^-n_K``, ``D (1 - eps^2)^-n_D``, ``lam (1 - eps)^b`` (Muszynska 1988; Hua 2005).

    Published ranges are 0.5 < n < 3 and 0 < b < 1. The limits here are wider, so that zero, no change with
    eccentricity, is an ordinary value. The exponent n_K is what tells K0 from stiffness that does not change with
    eccentricity: a one-mode rotor's K and K0, of which a linear test sees the sum only, are separated by this law,
    and no better than the law holds.
    """

    name: ClassVar[str] = "muszynska"

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """See :attr:`Law.parameters`."""
        return (
            Parameter("n_K", "1", "exponent of the fluid radial stiffness in eccentricity", lower=-2.0, upper=10.0),
            Parameter("n_D", "1", "exponent of the fluid radial damping in eccentricity", lower=-2.0, upper=10.0),
            Parameter("b", "1", "exponent of the velocity ratio in eccentricity", scale=0.5, lower=-2.0, upper=5.0),
        )

    def at(self, p: Any, eccentricity: Any) -> Fluid:
        """See :meth:`Law.at`."""
        wide, gap = ca.log1p(-(eccentricity**2)), ca.log1p(-eccentricity)
        return Fluid(p.K0 * ca.exp(-p.n_K * wide), p.D * ca.exp(-p.n_D * wide), ca.exp(p.b * gap))


@dataclass(frozen=True)
class EvenPolynomial(Law):
    """``K0 + K0_2 eps^2 + K0_4 eps^4 + ...``, D likewise, ``lam (1 + lam_2 eps^2 + ...)``.

    Makes no assumption on the form, so that stiffness of the rotor itself in the journal's plane (K of one mode, K3
    of whirl and whip) and K0 are known as their sum only.

    Args:
        terms: number of even powers above zero, 1 to 4.
    """

    name: ClassVar[str] = "even-polynomial"
    terms: int = 2

    def __post_init__(self) -> None:
        if not 1 <= self.terms <= 4:
            raise ValueError(f"an even polynomial has 1 to 4 terms above the constant, got {self.terms}")

    @property
    def _powers(self) -> range:
        return range(2, 2 * self.terms + 1, 2)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """See :attr:`Law.parameters`."""
        kinds = (
            ("K0", "N/m", "fluid radial stiffness", 1e4),
            ("D", "N s/m", "fluid radial damping", 500.0),
            ("lam", "1", "relative change of the velocity ratio", 1.0),
        )
        return tuple(
            Parameter(f"{name}_{k}", unit, f"{meaning}, factor of eps^{k}", scale)
            for name, unit, meaning, scale in kinds
            for k in self._powers
        )

    def at(self, p: Any, eccentricity: Any) -> Fluid:
        """See :meth:`Law.at`."""
        change = {
            name: sum(getattr(p, f"{name}_{k}") * eccentricity**k for k in self._powers) for name in ("K0", "D", "lam")
        }
        return Fluid(p.K0 + change["K0"], p.D + change["D"], 1.0 + change["lam"])

    def start(self, K0: float, D: float) -> dict[str, float]:
        """See :meth:`Law.start`."""
        return {parameter.name: 0.0 for parameter in self.parameters}


@dataclass(frozen=True)
class MonotoneSpline(Law):
    """Quadratic I-splines: K0 and D never fall with eccentricity, lam never rises.

    ``K0 + sum_i K0_si I_i(eps)``, D likewise, ``lam (1 - sum_i lam_si I_i(eps))`` with all factors at least zero.
    Each I_i rises smoothly from 0 to 1 around a knot (Ramsay 1988), so that a factor is a rise. K0 and D begin with
    slope zero, as even functions do. What is said on K and K0 under :class:`EvenPolynomial` holds here too.

    Args:
        knots: inner knots, ascending between 0 and ``reach``.
        reach: eccentricity beyond which nothing changes; choose that of the data.
    """

    name: ClassVar[str] = "monotone-spline"
    knots: tuple[float, ...] = (0.35, 0.65)
    reach: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "knots", tuple(float(k) for k in self.knots))
        nodes = self._nodes
        if not 0 < self.reach <= 1 or any(a >= b for a, b in pairwise(nodes)):
            raise ValueError(
                f"knots must ascend between 0 and reach, and reach lie in (0, 1]; got knots {self.knots} and reach "
                f"{self.reach}"
            )

    @property
    def _nodes(self) -> tuple[float, ...]:
        return (0.0, *self.knots, self.reach)

    @property
    def _spline(self) -> range:
        """Numbers of the splines with slope zero at the centre; number 0 rises from the centre on."""
        return range(1, len(self._nodes))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """See :attr:`Law.parameters`."""
        at = [significant(node, 3) for node in self._nodes]
        kinds = (
            ("K0", "N/m", "rise of the fluid radial stiffness", 1e4, self._spline),
            ("D", "N s/m", "rise of the fluid radial damping", 500.0, self._spline),
            ("lam", "1", "relative fall of the velocity ratio", 0.2, (0, *self._spline)),
        )
        return tuple(
            Parameter(f"{name}_s{i}", unit, f"{meaning} around eps = {at[i]}", scale, 0.0)
            for name, unit, meaning, scale, numbers in kinds
            for i in numbers
        )

    def at(self, p: Any, eccentricity: Any) -> Fluid:
        """See :meth:`Law.at`."""
        basis = [i_spline(self._nodes, i, eccentricity) for i in range(len(self._nodes))]
        K0 = p.K0 + sum(getattr(p, f"K0_s{i}") * basis[i] for i in self._spline)
        D = p.D + sum(getattr(p, f"D_s{i}") * basis[i] for i in self._spline)
        return Fluid(K0, D, 1.0 - sum(getattr(p, f"lam_s{i}") * basis[i] for i in (0, *self._spline)))

    def start(self, K0: float, D: float) -> dict[str, float]:
        """See :meth:`Law.start`."""
        share = {"K0": 0.2 * abs(K0), "D": 0.2 * abs(D), "lam": 0.05}
        return {q.name: share[q.name.rpartition("_")[0]] for q in self.parameters}


def i_spline(nodes: Sequence[float], number: int, x: Any) -> Any:
    """Integral, from the first node, of the hat function on ``nodes[number]``, scaled to rise from 0 to 1."""
    left, centre, right = nodes[max(number - 1, 0)], nodes[number], nodes[min(number + 1, len(nodes) - 1)]
    height = 2.0 / (right - left)
    total: Any = 0.0
    if centre > left:
        way = ca.fmin(ca.fmax(x - left, 0.0), centre - left)
        total = total + height * way**2 / (2 * (centre - left))
    if right > centre:
        way = ca.fmin(ca.fmax(x - centre, 0.0), right - centre)
        total = total + height * (way - way**2 / (2 * (right - centre)))
    return total


@dataclass(frozen=True)
class LinearInSpeed(Law):
    """``lam (1 + lam_speed (Om/Om0 - 1))``, K0 and D likewise: values that change in proportion to the speed.

    K0, D and lam are those at the reference speed Om0. Tests at two speeds or more tell the changes, and the threshold
    speed extrapolates them with their errors. There is no clearance, and nothing changes with eccentricity.

    Args:
        values: which of K0, D and lam change.
        speed_rpm: reference speed, best one amid those tested.
    """

    name: ClassVar[str] = "linear-in-speed"
    of_eccentricity: ClassVar[bool] = False
    values: tuple[str, ...] = ("K0", "D", "lam")
    speed_rpm: float = 1000.0

    def __post_init__(self) -> None:
        given = (self.values,) if isinstance(self.values, str) else tuple(self.values)
        if not given or len(set(given)) != len(given) or not set(given) <= {"K0", "D", "lam"}:
            raise ValueError(f"values that change with speed are K0, D and lam, each once, got {given}")
        if not 0 < self.speed_rpm < float("inf"):
            raise ValueError(f"speed_rpm must be positive, got {self.speed_rpm}")
        object.__setattr__(self, "values", given)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """See :attr:`Law.parameters`."""
        meaning = f"share by which %s changes from {self.speed_rpm:g} rpm to twice that"
        return tuple(
            Parameter(f"{value}_speed", "1", meaning % value, scale=0.1, lower=-3.0, upper=3.0) for value in self.values
        )

    def at(self, p: Any, eccentricity: Any) -> Fluid:
        """See :meth:`Law.at`; at the reference speed."""
        return Fluid(p.K0, p.D, 1.0)

    def at_speed(self, p: Any, eccentricity: Any, speed: Any) -> Fluid:
        """See :meth:`Law.at_speed`."""
        beyond = speed / (self.speed_rpm * math.pi / 30) - 1
        factor = {v: 1 + getattr(p, f"{v}_speed") * beyond if v in self.values else 1.0 for v in ("K0", "D", "lam")}
        return Fluid(p.K0 * factor["K0"], p.D * factor["D"], factor["lam"])

    def start(self, K0: float, D: float) -> dict[str, float]:
        """See :meth:`Law.start`."""
        return {parameter.name: 0.0 for parameter in self.parameters}


@dataclass(frozen=True)
class Collapse(Law):
    """``lam (1 - fall eps^2) / (1 + (eps/edge)^sharpness)``: a velocity ratio that falls slightly, then collapses.

    The paper saw it in static-load and impulse tests (Figs 27 to 29): around the centre the fluid is dragged round, at
    high eccentricity it flows along the shaft, and the higher the speed the earlier. Half of lam is left at the edge,
    ``edge exp(-edge_speed (Om/Om0 - 1))``. K0 and D stiffen as in :class:`Muszynska`.

    Args:
        speed_rpm: reference speed Om0, best one amid those tested; a single tested speed does not tell ``edge_speed``.
    """

    name: ClassVar[str] = "collapse"
    speed_rpm: float = 1000.0

    def __post_init__(self) -> None:
        if not 0 < self.speed_rpm < float("inf"):
            raise ValueError(f"speed_rpm must be positive, got {self.speed_rpm}")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """See :attr:`Law.parameters`."""
        at = f"at {self.speed_rpm:g} rpm"
        return (
            *Muszynska().parameters[:2],
            Parameter("fall", "1", "relative fall of the velocity ratio, factor of eps^2", 0.2, lower=-1.0, upper=1.0),
            Parameter("edge", "1", f"eccentricity that leaves half of the velocity ratio, {at}", 0.7, 0.05, 3.0),
            Parameter("sharpness", "1", "exponent with which the velocity ratio collapses", 8.0, 2.0, 100.0),
            Parameter("edge_speed", "1", "relative fall of the edge with speed", 0.1, lower=-3.0, upper=3.0),
        )

    def at(self, p: Any, eccentricity: Any) -> Fluid:
        """See :meth:`Law.at`; at the reference speed."""
        return self.at_speed(p, eccentricity, self.speed_rpm * math.pi / 30)

    def at_speed(self, p: Any, eccentricity: Any, speed: Any) -> Fluid:
        """See :meth:`Law.at_speed`."""
        least = 1e-12  # eccentricity below which the logarithm is level: the power is zero there to any digits
        edge = ca.log(p.edge) - p.edge_speed * (speed / (self.speed_rpm * math.pi / 30) - 1)
        collapse = 1 / (1 + ca.exp(p.sharpness * (ca.log(eccentricity + least) - edge)))
        wide = ca.log1p(-(eccentricity**2))
        return Fluid(
            p.K0 * ca.exp(-p.n_K * wide), p.D * ca.exp(-p.n_D * wide), (1 - p.fall * eccentricity**2) * collapse
        )

    def start(self, K0: float, D: float) -> dict[str, float]:
        """See :meth:`Law.start`."""
        return {"n_K": 1.0, "n_D": 1.0, "fall": 0.1, "edge": 0.7, "sharpness": 8.0, "edge_speed": 0.0}


LAWS: dict[str, type[Law]] = {
    law.name: law for law in (Constant, Muszynska, EvenPolynomial, MonotoneSpline, LinearInSpeed, Collapse)
}
"""Laws by name."""


def clearance_of(law: Law, clearance_um: float | None, model: str) -> float | None:
    """Clearance in m, checked against the law."""
    if clearance_um is None:
        if law.of_eccentricity:
            raise ValueError(
                f"{model}: law {law.name} depends on eccentricity = |journal displacement| / clearance; give "
                "the radial clearance in micrometres (clearance_um=, --clearance-um)"
            )
        return None
    if not 0 < clearance_um < float("inf"):
        raise ValueError(f"{model}: clearance_um must be positive, got {clearance_um}")
    return clearance_um * 1e-6
