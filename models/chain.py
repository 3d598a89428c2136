"""A rotor as n masses in line between n + 1 springs (eqs 24 to 26; eq. 19 is the case n = 2)."""

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

MOST_MASSES = 20
"""Longest chain: beyond it modes of a real shaft say nothing about single springs."""


class Chain(RotorModel):
    """Masses M1 to Mn between springs K1, from the first bearing, to K(n+1), to the last bearing.

    Each mass has an external damper Ds1 to Dsn. Masses and springs that reproduce natural frequencies and mode shapes
    come from :func:`rotorfit.models.chain_from_modes`.

    Args:
        n: number of masses, 1 to 20; by default that of ``planes``, else two.
        planes: names of the masses' planes in their order along the shaft, by default ``mass-1`` to ``mass-n``.
        fluid: plane at which the fluid force of eq. (13) acts, none by default.
        blocks: structural blocks to allow for, of ``rf.models.BLOCKS``.
        two_lam: let damping and inertia of the fluid turn at ratios of their own, lam_D and lam_M.
        law: how the fluid changes with eccentricity, for instance ``rf.models.Muszynska()``.
        clearance_um: radial clearance at the fluid, micrometres; needed by a law.
        betas: factors of the probes, ``beta1``, ... in the order of the planes, known to be 1 unless freed; naming one
            in a fit, ``known={"beta2": None}``, asks for them too.
        probes: probes between the planes, ``{"quarter": {"disk": 0.6, "journal": 0.4}}``: shares of the planes' motion;
            their factors follow those of the planes.

    Raises:
        ValueError: n out of range or not that of the planes, the fluid at a plane that the chain does not have, or a
            law without fluid or clearance.
    """

    name: ClassVar[str] = "chain"

    def __init__(
        self,
        n: int | None = None,
        planes: Sequence[str] | None = None,
        *,
        fluid: str | None = None,
        blocks: Sequence[str] = (),
        two_lam: bool = False,
        law: Law | None = None,
        clearance_um: float | None = None,
        betas: bool = False,
        probes: Mapping[str, Mapping[str, float]] | None = None,
    ) -> None:
        count = n if n is not None else 2 if planes is None else len(planes)
        if not 1 <= count <= MOST_MASSES:
            raise ValueError(f"a chain has 1 to {MOST_MASSES} masses, got {count}")
        names = [f"mass-{i + 1}" for i in range(count)] if planes is None else planes
        self.planes = one_per_coordinate(names, count, self.name)
        if fluid is not None and fluid not in self.planes:
            raise ValueError(f"the fluid acts at plane {fluid!r}, but the chain has {', '.join(self.planes)}")
        if two_lam and fluid is None:
            raise ValueError("two_lam needs a fluid: say at which plane it acts, fluid=...")
        if law is not None and law.parameters and fluid is None:
            raise ValueError("a law needs a fluid: say at which plane it acts, fluid=...")
        self.fluid = fluid
        self.law = law or Constant()
        self.clearance_um = clearance_um
        self.clearance = clearance_of(self.law, clearance_um, self.name)
        self.betas = betas
        self.probes = check_probes(probes, self.planes, self.name)
        self.blocks = check_blocks(blocks)
        self.two_lam = two_lam
        places = range(1, count + 1)
        self.parameters = (
            *(Parameter(f"M{i}", "kg", f"modal mass {i}", scale=1.0, lower=0.0) for i in places),
            *(
                Parameter(f"K{i}", "N/m", f"stiffness, {_station(i - 1, count)} to {_station(i, count)}", scale=2e4)
                for i in range(1, count + 2)
            ),
            *(Parameter(f"Ds{i}", "N s/m", f"external damping at mass {i}", scale=10.0) for i in places),
            *(() if fluid is None else (*fluid_parameters(two_lam), *self.law.parameters)),
            *block_parameters(self.blocks, count),
            *(probe_parameters(self.planes, self.probes) if betas or probes else ()),
        )

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """See :meth:`RotorModel.equation`."""
        n = len(self.planes)
        K = [getattr(p, f"K{i + 1}") for i in range(n + 1)]
        stiffness = _diagonal([K[i] + K[i + 1] for i in range(n)])
        damping = _diagonal([getattr(p, f"Ds{i + 1}") for i in range(n)])
        mass = _diagonal([getattr(p, f"M{i + 1}") for i in range(n)])
        for i in range(n - 1):
            stiffness[i][i + 1] = stiffness[i + 1][i] = -K[i + 1]
        if self.fluid is not None:
            at = self.planes.index(self.fluid)
            force = fluid_at(self.law, p, self.two_lam, speed, eccentricity)
            stiffness[at][at] = force.K + stiffness[at][at]
            damping[at][at] = force.C + damping[at][at]
            mass[at][at] = force.M + mass[at][at]
        return add_blocks([stiffness, damping, mass], self.blocks, p, speed)


def _station(i: int, n: int) -> str:
    return "bearing" if i in (0, n + 1) else f"mass {i}"


def _diagonal(entries: Sequence[Any]) -> list[list[Any]]:
    return [[entry if row == column else 0.0 for column in range(len(entries))] for row, entry in enumerate(entries)]
