"""Lumped rotors: one mode, whirl and whip, two disks, an overhung disk, chains of masses, and full matrices."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Literal

from rotorfit.models.complexes import J
from rotorfit.models.fluid import Clearances, Laws, fluids_of, laws_and_clearances
from rotorfit.models.laws import Law
from rotorfit.models.model import Coordinate, Matrix, RotorModel
from rotorfit.models.parameters import MATRIX_UNITS, Parameter
from rotorfit.models.probes import check_probes, probe_parameters
from rotorfit.models.structure import add_blocks, block_parameters, check_blocks


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
        self.fluids = fluids_of(self.planes[0], law, two_lam=two_lam)
        self.law, self.clearance_um, self.clearance = laws_and_clearances(self.fluids, law, clearance_um, self.name)
        self.betas = betas
        self.probes = check_probes(probes, self.planes, self.name)
        self.parameters = (
            Parameter("M", "kg", "rotor modal mass", scale=1.0, lower=0.0),
            Parameter("K", "N/m", "rotor modal stiffness", scale=1e4),
            Parameter("Ds", "N s/m", "rotor external damping", scale=10.0),
            *self.fluids[0].parameters,
            *(probe_parameters(self.planes, self.probes) if betas or probes else ()),
        )

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """See :meth:`RotorModel.equation`."""
        fluid = self.fluids[0].force(p, speed, eccentricity)
        return [[p.K + fluid.K]], [[p.Ds + fluid.C]], [[p.M + fluid.M]]


def one_per_coordinate(planes: Sequence[str], count: int, model: str) -> tuple[str, ...]:
    """Check the plane names of a model."""
    names = (planes,) if isinstance(planes, str) else tuple(planes)
    if len(names) != count or len(set(names)) != count:
        raise ValueError(f"{model} has {count} plane{'s' * (count > 1)}, each with a name of its own; got {names}")
    return names


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
        self.fluids = fluids_of(self.planes[1], law, two_lam=two_lam)
        self.law, self.clearance_um, self.clearance = laws_and_clearances(self.fluids, law, clearance_um, self.name)
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
            *self.fluids[0].parameters,
            *block_parameters(self.blocks, 2),
            *(probe_parameters(self.planes, self.probes) if betas or probes else ()),
        )

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """See :meth:`RotorModel.equation`."""
        fluid = self.fluids[0].force(p, speed, eccentricity)
        stiffness = [[p.K1 + p.K2, -p.K2 * p.sigma], [-p.K2, fluid.K + p.K3 + p.K2 * p.sigma]]
        damping = [[p.Ds, 0.0], [0.0, fluid.C]]
        mass = [[p.Md, 0.0], [0.0, p.Mb + fluid.M]]
        return add_blocks([stiffness, damping, mass], self.blocks, p, speed)


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


class Overhung(RotorModel):
    """Disk displacement z and tilt phi = dx/ds + j dy/ds of an overhung disk.

    ``kappa = [[k11 + j w d1 - M w^2, k12], [k12, k22 + j w d2 + Om w Ip - It w^2]]``. At zero speed Ip is not
    observable.

    Args:
        planes: name of the disk plane.
        coupling_mass: allow for ``-w^2 m12`` beside k12, which a shaft with mass leaves when condensed to the disk.
        betas: a factor of the disk's probe, ``beta1``, known to be 1 unless freed.
    """

    name: ClassVar[str] = "overhung"

    def __init__(self, planes: Sequence[str] = ("disk",), *, coupling_mass: bool = False, betas: bool = False) -> None:
        self.betas = betas
        self.coupling_mass = coupling_mass
        self.planes = one_per_coordinate(planes, 1, self.name)
        self.parameters = (
            Parameter("M", "kg", "disk mass", scale=5.0, lower=0.0),
            Parameter("It", "kg m^2", "transverse moment of inertia", scale=0.1, lower=0.0),
            Parameter("Ip", "kg m^2", "polar moment of inertia", scale=0.2, lower=0.0),
            Parameter("k11", "N/m", "stiffness, force for displacement", scale=1e5),
            Parameter("k12", "N", "coupling stiffness, force for tilt", scale=1e4),
            Parameter("k22", "N m", "stiffness, moment for tilt", scale=1e4),
            Parameter("d1", "N s/m", "damping of the displacement", scale=10.0),
            Parameter("d2", "N m s", "damping of the tilt", scale=1.0),
            *(
                (Parameter("m12", "kg m", "coupling mass of displacement and tilt", scale=0.1),)
                if coupling_mass
                else ()
            ),
            *(probe_parameters(self.planes, ()) if betas else ()),
        )

    @property
    def coordinates(self) -> tuple[Coordinate, ...]:
        """Displacement and tilt of the disk."""
        return Coordinate(self.planes[0], "z"), Coordinate(self.planes[0], "r")

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """See :meth:`RotorModel.equation`."""
        stiffness = [[p.k11, p.k12], [p.k12, p.k22]]
        damping = [[p.d1, 0.0], [0.0, p.d2 - J * (p.Ip * speed)]]
        m12 = p.m12 if self.coupling_mass else 0.0
        mass = [[p.M, m12], [m12, p.It]]
        return stiffness, damping, mass


MOST_MASSES = 20
"""Longest chain: beyond it modes of a real shaft say nothing about single springs."""


class Chain(RotorModel):
    """Masses M1 to Mn between springs K1, from the first bearing, to K(n+1), to the last bearing.

    Each mass has an external damper Ds1 to Dsn. Masses and springs that reproduce natural frequencies and mode shapes
    come from :func:`rotorfit.models.chain_from_modes`.

    Args:
        n: number of masses, 1 to 20; by default that of ``planes``, else two.
        planes: names of the masses' planes in their order along the shaft, by default ``mass-1`` to ``mass-n``.
        fluid: plane or planes at which the fluid force of eq. (13) acts, none by default; with several its parameters
            are ``K0_seal`` and so on, by plane.
        sigma: a modal correction factor, as in eq. (18), of each spring between masses: ``sigma2`` of K2.
        blocks: structural blocks to allow for, of ``rf.models.BLOCKS``.
        two_lam: let damping and inertia of the fluid turn at ratios of their own, lam_D and lam_M.
        law: how the fluid changes with eccentricity, for instance ``rf.models.Muszynska()``; of several fluids by
            plane, ``{"seal": rf.models.Muszynska()}``, with eccentricity at one of them.
        clearance_um: radial clearance at the fluid, micrometres, one or by plane; needed by a law.
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
        fluid: str | Sequence[str] | None = None,
        sigma: bool = False,
        blocks: Sequence[str] = (),
        two_lam: bool = False,
        law: Laws | None = None,
        clearance_um: Clearances | None = None,
        betas: bool = False,
        probes: Mapping[str, Mapping[str, float]] | None = None,
    ) -> None:
        if n is not None and not isinstance(n, int):
            raise TypeError(f"a chain has a number of masses, got {n!r}; its planes are named by planes=")
        count = n if n is not None else 2 if planes is None else len(planes)
        if not 1 <= count <= MOST_MASSES:
            raise ValueError(f"a chain has 1 to {MOST_MASSES} masses, got {count}")
        names = [f"mass-{i + 1}" for i in range(count)] if planes is None else planes
        self.planes = one_per_coordinate(names, count, self.name)
        self.fluids = fluids_of(fluid, law, two_lam=two_lam)
        for own in self.fluids:
            if own.plane not in self.planes:
                raise ValueError(f"the fluid acts at plane {own.plane!r}, but the chain has {', '.join(self.planes)}")
        if two_lam and fluid is None:
            raise ValueError("two_lam needs a fluid: say at which plane it acts, fluid=...")
        self.fluid = fluid if fluid is None or isinstance(fluid, str) else tuple(fluid)
        self.sigma = sigma
        self.law, self.clearance_um, self.clearance = laws_and_clearances(self.fluids, law, clearance_um, self.name)
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
            *(
                Parameter(f"sigma{i}", "1", f"modal correction factor of the coupling by K{i}", nominal=1.0)
                for i in range(2, count + 1)
                if sigma
            ),
            *(Parameter(f"Ds{i}", "N s/m", f"external damping at mass {i}", scale=10.0) for i in places),
            *(q for own in self.fluids for q in own.parameters),
            *block_parameters(self.blocks, count),
            *(probe_parameters(self.planes, self.probes) if betas or probes else ()),
        )

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """See :meth:`RotorModel.equation`."""
        n = len(self.planes)
        K = [getattr(p, f"K{i + 1}") for i in range(n + 1)]
        sigma = [getattr(p, f"sigma{i + 1}", 1.0) for i in range(n)]
        stiffness = _diagonal([K[i] * sigma[i] + K[i + 1] for i in range(n)])
        damping = _diagonal([getattr(p, f"Ds{i + 1}") for i in range(n)])
        mass = _diagonal([getattr(p, f"M{i + 1}") for i in range(n)])
        for i in range(n - 1):
            stiffness[i][i + 1], stiffness[i + 1][i] = -K[i + 1] * sigma[i + 1], -K[i + 1]
        for fluid in self.fluids:
            at = self.planes.index(fluid.plane)
            force = fluid.force(p, speed, eccentricity)
            stiffness[at][at] = force.K + stiffness[at][at]
            damping[at][at] = force.C + damping[at][at]
            mass[at][at] = force.M + mass[at][at]
        return add_blocks([stiffness, damping, mass], self.blocks, p, speed)


def _station(i: int, n: int) -> str:
    return "bearing" if i in (0, n + 1) else f"mass {i}"


def _diagonal(entries: Sequence[Any]) -> list[list[Any]]:
    return [[entry if row == column else 0.0 for column in range(len(entries))] for row, entry in enumerate(entries)]


_MEANING = {"K": "stiffness", "D": "damping", "M": "inertia"}
_SCALE = {"K": 1e4, "D": 10.0, "M": 1.0}


class Anisotropic(RotorModel):
    """Full stiffness, damping and inertia matrices of eq. (1) in x and y at n planes.

    ``Kxy_12`` is the force in x at plane 1 for a displacement in y at plane 2; with one plane the index is left out.

    Args:
        planes: names of the measuring planes.
    """

    name: ClassVar[str] = "anisotropic"
    force_alone = True
    frame: Literal["z", "xy"] = "xy"

    def __init__(self, planes: Sequence[str] = ("journal",)) -> None:
        names = (planes,) if isinstance(planes, str) else tuple(planes)
        self.planes = one_per_coordinate(names, max(len(names), 1), self.name)
        if len(names) == 1:
            self.leads = ("coefficients",)
        self.parameters = tuple(
            Parameter(self._entry(kind, row, column), MATRIX_UNITS[kind], _MEANING[kind] + " coefficient", _SCALE[kind])
            for kind in "KDM"
            for row in range(2 * len(names))
            for column in range(2 * len(names))
        )

    def _entry(self, kind: str, row: int, column: int) -> str:
        count = len(self.planes)
        (q, r), (p, s) = divmod(row, count), divmod(column, count)
        separator = "" if count < 10 else "_"
        index = "" if count == 1 else f"_{r + 1}{separator}{s + 1}"
        return f"{kind}{'xy'[q]}{'xy'[p]}{index}"

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> Sequence[Matrix]:
        """See :meth:`RotorModel.equation`."""
        size = range(2 * len(self.planes))
        return [[[getattr(p, self._entry(kind, row, column)) for column in size] for row in size] for kind in "KDM"]
