"""Two complex modes, whirl and whip: flexible rotor with a disk, journal in a fluid bearing (eq. 18)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from rotorfit.models.fluid import fluid_at, fluid_parameters
from rotorfit.models.laws import Constant, Law, clearance_of
from rotorfit.models.model import Matrix, RotorModel
from rotorfit.models.one_mode import one_per_coordinate
from rotorfit.models.parameters import Parameter
from rotorfit.models.probes import check_probes, probe_parameters
from rotorfit.models.structure import add_blocks, block_parameters, check_blocks


class WhirlWhip(RotorModel):
    """Disk and journal of eq. (18), the journal in a fluid.

    Args:
        planes: names of the disk plane and the journal plane.
        blocks: structural blocks to allow for, of ``rf.models.BLOCKS``.
        two_lam: let damping and inertia turn at ratios of their own, lam_D and lam_M.
        law: how the fluid changes with the journal's eccentricity, for instance ``rf.models.Muszynska()``.
        clearance_um: radial clearance of the bearing, micrometres; needed by a law.
        betas: factors of the probes, ``beta1``, ... in the order of the planes, known to be 1 unless freed; naming one
            in a fit, ``known={"beta2": None}``, asks for them too.
        probes: probes between the planes, ``{"quarter": {"disk": 0.6, "journal": 0.4}}``: shares of the planes' motion;
            their factors follow those of the planes.
    """

    name: ClassVar[str] = "whirl-whip"
    caveats = (
        "K0, K1 and K2 are those of a lumped chain, which shares stiffness out between them: K0 is not the fluid's own "
        "radial stiffness unless the shaft's matrices are known",
    )

    def __init__(
        self,
        planes: Sequence[str] = ("disk", "journal"),
        *,
        blocks: Sequence[str] = (),
        two_lam: bool = False,
        law: Law | None = None,
        clearance_um: float | None = None,
        betas: bool = False,
        probes: Mapping[str, Mapping[str, float]] | None = None,
    ) -> None:
        self.planes = one_per_coordinate(planes, 2, self.name)
        self.blocks = check_blocks(blocks)
        self.two_lam = two_lam
        self.law = law or Constant()
        self.clearance_um = clearance_um
        self.clearance = clearance_of(self.law, clearance_um, self.name)
        self.betas = betas
        self.probes = check_probes(probes, self.planes, self.name)
        self.parameters = (
            Parameter("Md", "kg", "disk modal mass", scale=1.0, lower=0.0),
            Parameter("Ds", "N s/m", "external damping at the disk", scale=5.0),
            Parameter("K1", "N/m", "shaft stiffness, disk to fixed bearing", scale=2e4),
            Parameter("K2", "N/m", "shaft stiffness, disk to journal", scale=2e4),
            Parameter("sigma", "1", "modal correction factor of the disk-journal coupling", nominal=1.0),
            Parameter("Mb", "kg", "journal modal mass", scale=0.3),
            Parameter("K3", "N/m", "external supporting spring at the journal", scale=5e3),
            *fluid_parameters(two_lam),
            *self.law.parameters,
            *block_parameters(self.blocks, 2),
            *(probe_parameters(self.planes, self.probes) if betas or probes else ()),
        )

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """See :meth:`RotorModel.equation`."""
        fluid = fluid_at(self.law, p, self.two_lam, speed, eccentricity)
        stiffness = [[p.K1 + p.K2, -p.K2 * p.sigma], [-p.K2, fluid.K + p.K3 + p.K2 * p.sigma]]
        damping = [[p.Ds, 0.0], [0.0, fluid.C]]
        mass = [[p.Md, 0.0], [0.0, p.Mb + fluid.M]]
        return add_blocks([stiffness, damping, mass], self.blocks, p, speed)
