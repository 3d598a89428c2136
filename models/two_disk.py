"""Two disks on a flexible shaft in rigid bearings, identified from synchronous runs (eqs 19 to 23)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

from rotorfit.models.model import Matrix, RotorModel
from rotorfit.models.one_mode import one_per_coordinate
from rotorfit.models.parameters import Parameter
from rotorfit.models.probes import check_probes, probe_parameters
from rotorfit.models.structure import add_blocks, block_parameters, check_blocks


class TwoDisk(RotorModel):
    """Two-disk rotor of eq. (19); ``D12`` and ``D21`` enter with the minus sign that eq. (19) writes outside.

    ``beta1`` and ``beta2`` multiply the readings of the two probes (probes off the modal stations).

    Args:
        planes: names of the two disk planes.
        blocks: structural blocks to allow for.
        probes: probes between the planes, ``{"middle": {"inboard": 0.5, "outboard": 0.5}}``: shares of the planes'
            motion; their factors follow ``beta1`` and ``beta2``.
    """

    name: ClassVar[str] = "two-disk"

    def __init__(
        self,
        planes: Sequence[str] = ("inboard", "outboard"),
        *,
        blocks: Sequence[str] = (),
        probes: Mapping[str, Mapping[str, float]] | None = None,
    ) -> None:
        self.planes = one_per_coordinate(planes, 2, self.name)
        self.blocks = check_blocks(blocks)
        self.probes = check_probes(probes, self.planes, self.name)
        self.parameters = (
            Parameter("M1", "kg", "modal mass of the first disk", scale=1.0, lower=0.0),
            Parameter("M2", "kg", "modal mass of the second disk", scale=1.0, lower=0.0),
            Parameter("K1", "N/m", "stiffness, first disk to bearing", scale=2e4),
            Parameter("K2", "N/m", "stiffness between the disks", scale=5e4),
            Parameter("K3", "N/m", "stiffness, second disk to bearing", scale=2e4),
            Parameter("D11", "N s/m", "damping of the first disk", scale=10.0),
            Parameter("D12", "N s/m", "damping coupling, first row", scale=10.0),
            Parameter("D21", "N s/m", "damping coupling, second row", scale=10.0),
            Parameter("D22", "N s/m", "damping of the second disk", scale=10.0),
            *probe_parameters(self.planes, self.probes),
            *block_parameters(self.blocks, 2),
        )

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """See :meth:`RotorModel.equation`."""
        stiffness = [[p.K1 + p.K2, -p.K2], [-p.K2, p.K2 + p.K3]]
        damping = [[p.D11, -p.D12], [-p.D21, p.D22]]
        mass = [[p.M1, 0.0], [0.0, p.M2]]
        return add_blocks([stiffness, damping, mass], self.blocks, p, speed)
