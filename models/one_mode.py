"""One complex mode in a fluid: the rigid light rotor of eqs (10) to (13)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from rotorfit.models.fluid import fluid_at, fluid_parameters
from rotorfit.models.laws import Constant, Law, clearance_of
from rotorfit.models.model import Matrix, RotorModel
from rotorfit.models.parameters import Parameter
from rotorfit.models.probes import check_probes, probe_parameters


class OneMode(RotorModel):
    """Rotor mass, external damping and stiffness with the fluid force at one plane (eqs 10 to 13).

    ``kappa = K + K0 - M w^2 - Mf (w - lam Om)^2 + j Ds w + j D (w - lam Om)``.

    Args:
        planes: name of the measured plane.
        two_lam: let damping and inertia turn at ratios of their own, lam_D and lam_M.
        law: how the fluid changes with eccentricity, for instance ``rf.models.Muszynska()``.
        clearance_um: radial clearance at the fluid, micrometres; needed by a law.
        betas: factors of the probes, ``beta1``, ... in the order of the planes, known to be 1 unless freed; naming one
            in a fit, ``known={"beta2": None}``, asks for them too.
        probes: probes between the planes, ``{"quarter": {"disk": 0.6, "journal": 0.4}}``: shares of the planes' motion;
            their factors follow those of the planes.
    """

    name: ClassVar[str] = "one-mode"

    def __init__(
        self,
        planes: Sequence[str] = ("journal",),
        *,
        two_lam: bool = False,
        law: Law | None = None,
        clearance_um: float | None = None,
        betas: bool = False,
        probes: Mapping[str, Mapping[str, float]] | None = None,
    ) -> None:
        self.planes = one_per_coordinate(planes, 1, self.name)
        self.two_lam = two_lam
        self.law = law or Constant()
        self.clearance_um = clearance_um
        self.clearance = clearance_of(self.law, clearance_um, self.name)
        self.betas = betas
        self.probes = check_probes(probes, self.planes, self.name)
        self.parameters = (
            Parameter("M", "kg", "rotor modal mass", scale=1.0, lower=0.0),
            Parameter("K", "N/m", "rotor modal stiffness", scale=1e4),
            Parameter("Ds", "N s/m", "rotor external damping", scale=10.0),
            *fluid_parameters(two_lam),
            *self.law.parameters,
            *(probe_parameters(self.planes, self.probes) if betas or probes else ()),
        )

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """See :meth:`RotorModel.equation`."""
        fluid = fluid_at(self.law, p, self.two_lam, speed, eccentricity)
        return [[p.K + fluid.K]], [[p.Ds + fluid.C]], [[p.M + fluid.M]]


def one_per_coordinate(planes: Sequence[str], count: int, model: str) -> tuple[str, ...]:
    """Check the plane names of a model."""
    names = (planes,) if isinstance(planes, str) else tuple(planes)
    if len(names) != count or len(set(names)) != count:
        raise ValueError(f"{model} has {count} plane{'s' * (count > 1)}, each with a name of its own; got {names}")
    return names
