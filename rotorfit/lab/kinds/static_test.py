"""Tests under constant loads: positions of a journal, without a turning force."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float, Index, Text
from rotorfit.base.digits import counted
from rotorfit.base.units import UNITS
from rotorfit.estimators.blocks.nonlinear import OrbitResponses
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.blocks.row_keys import distinguished
from rotorfit.estimators.noise.sweep_noise import noise_from_smoothness
from rotorfit.lab.data.findings import Finding, listed, rows_of
from rotorfit.lab.data.rows import PLACEHOLDER, Experiment
from rotorfit.lab.data.table_columns import Column, Layout, X, Y, noise
from rotorfit.lab.observing.rows import check_clearance, check_finite, check_planes, of_rows, spread_of_repeats
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import journal


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class StaticTest(Experiment):
    """Displacements of a turning rotor under constant loads, one row a load (Figs 26 to 28).

    Attributes:
        run: name of the run, shape ``(R,)`` like all that follow.
        speed: rotative speed, rad/s.
        load_plane: plane of the load.
        load: ``Px + j Py = P exp(j g)``, N.
        plane: plane of the probes.
        displacement: displacement from the centre of the bearing or seal, ``x + j y``, m.
        sigma: standard deviation of x and of y, m, NaN if unknown.
        attributes, source: see :class:`PerturbationTest`.
    """

    title: ClassVar[str] = "static-load test"
    layout: ClassVar[Layout] = Layout(
        columns=(
            Column("load_plane", otherwise="journal"),
            Column("load", (("load", "N", UNITS["force"]), ("load", "deg", UNITS["angle"])), polar=True),
            Column("plane", otherwise="journal"),
            Column("displacement", (X, Y)),
            noise("um", UNITS["length"]),
        ),
        marks=("load_",),
        run="static",
        known="speed_rpm, load_N, load_deg, x_um, y_um, optional run, "
        "plane and load_plane (by default journal), sigma_um",
    )
    reads: ClassVar[Literal["motion", "force", ""]] = "motion"
    reducer: ClassVar[str] = "static_positions"

    load_plane: Text
    load: ComplexArray
    plane: Text
    displacement: ComplexArray
    sigma: Float

    @property
    def motion(self) -> ComplexArray:
        """The displacements."""
        return self.displacement

    @property
    def same_place(self) -> Index:
        """Number of the run, speed and load of each row, shape ``(R,)``."""
        return self.alike("run", "speed", "load_plane", "load")[1]

    @property
    def sizes(self) -> tuple[tuple[str, Float, str], ...]:
        """Loads and positions."""
        return ("load", np.abs(self.load), "N"), ("position", np.abs(self.displacement) * 1e6, "um")

    def excursion(self, plane: str, clearance: float) -> Float:
        """See any experiment."""
        return np.where(self.plane == plane, np.abs(self.displacement), np.nan)

    @property
    def force_planes(self) -> tuple[str, ...]:
        """Planes of the load in order of appearance."""
        return tuple(self.category("load_plane").names)

    def observe(self, model: RotorModel, group: Index) -> Block:
        """See any experiment."""
        return _observed(self, model, group)

    def own_findings(self) -> Iterator[Finding]:
        """See any experiment."""
        return _odd_positions(self)

    def unread(self, sigma: Float) -> Experiment:
        """See any experiment."""
        return replace(self, displacement=np.full(len(self), PLACEHOLDER), sigma=sigma)


def _observed(test: StaticTest, model: RotorModel, group: Index) -> Block:
    check_finite(test, test.load, test.displacement)
    check_planes(model, test, test.planes, test.force_planes, forces="load planes")
    if model.frame != "z":
        raise ValueError(f"{model.name} keeps x and y apart; static loads need a model in complex coordinates")
    idle = np.flatnonzero(test.load == 0)
    if idle.size:
        where = ", ".join(map(str, idle[:8] + 1))
        raise ValueError(
            f"{test.source or test.title}: the load is zero in {counted(idle.size, 'row')} ({where}); "
            "positions count from that without a load: subtract it from the others and leave it out"
        )
    count = len(test)
    still = np.zeros(count)
    force = np.zeros((count, len(model.coordinates)), dtype=complex)
    for plane in test.force_planes:
        at = test.load_plane == plane
        force[at] = model.force_vector(plane, still[at], test.load[at])
    coordinate = np.array([model.coordinate(plane, "z") for plane in test.plane.tolist()], dtype=np.intp)
    pairs = zip(test.run.tolist(), test.plane.tolist(), strict=True)
    rows = of_rows(model, test, (f"{run} / {plane} static" for run, plane in pairs))
    block = Responses(
        **rows,
        frequency=still,
        force=force,
        group=group,
        line=np.arange(count),
        coordinate=coordinate,
        measured=test.displacement,
        sigma=_static_noise(test, rows["label"]),
    )
    if not model.eccentricity_dependent:
        return block
    eps = _eccentricity(model, test, coordinate)
    sweep = test.alike("run", "speed", "load_plane", "plane")[1]
    return OrbitResponses(block, eps[None], "nearest" if np.isfinite(eps).all() else "followed", sweep)


def _eccentricity(model: RotorModel, test: StaticTest, coordinate: Index) -> Float:
    """Measured eccentricity of the journal in each row, NaN where no probe read it under that load."""
    seat = journal(model)
    eps = np.where(coordinate == seat.at, np.abs(test.displacement) / seat.clearance, np.nan)
    check_clearance(eps, seat.clearance, "static positions")
    loads = test.same_place
    for load in np.unique(loads[np.isnan(eps)]):  # other planes under a load share the journal's position
        here = loads == load
        if np.isfinite(eps[here]).any():
            eps[here] = np.where(np.isnan(eps[here]), np.nanmean(eps[here]), eps[here])
    return np.asarray(eps)


def _static_noise(test: StaticTest, label: Index) -> Float:
    """Noise given, else from repeated loads, else from the smoothness of the locus over the load."""
    sigma = test.sigma.copy()
    same, curves = distinguished(label, test.speed, test.load_plane, test.load)[1], distinguished(label, test.speed)[1]
    for curve in np.unique(curves[np.isnan(sigma)]):
        rows = np.flatnonzero(curves == curve)
        spread = spread_of_repeats(test.displacement[rows], same[rows])
        if spread is None:
            order = rows[np.argsort(np.abs(test.load[rows]), kind="stable")]
            try:
                spread = noise_from_smoothness(np.abs(test.load[order]), test.displacement[order])
            except ValueError as reason:
                raise ValueError(f"{test.source or 'static test'}, run {test.run[rows[0]]}: {reason}") from reason
        sigma[rows] = np.where(np.isnan(sigma[rows]), spread, sigma[rows])
    return sigma


def _odd_positions(test: StaticTest) -> Iterator[Finding]:
    """Rows without a load, and positions against the load or, by a fluid that turns backward, against the rotation.

    Under a load P a stable journal rests at P / (K - j D lam Omega): along the load and ahead of it in the sense of
    rotation where lam > 0.
    """
    idle = test.load == 0
    if idle.any():
        text = (
            f"The load is zero in {idle.sum()} rows. Positions count from that without a load: subtract it from the "
            "others and remove its row."
        )
        yield Finding("error", "no-load", text, rows_of(idle))
    turned = test.displacement * np.exp(-1j * np.angle(test.load))
    at_load = (test.plane == test.load_plane) & (test.load != 0)
    if back := _runs(test, at_load, turned.real):
        text = (
            f"The journal moves against the load in {listed(back)}. Check the direction of the load (load_deg, from x "
            "towards y), the signs of x and y, or x and y exchanged."
        )
        yield Finding("error", "against-load", text, rows_of(np.isin(test.run, back)))
    elif aside := _runs(test, at_load, turned.imag * np.sign(test.speed)):
        text = (
            f"Under load the journal moves to the side against the rotation in {listed(aside)}: lam would be negative. "
            "Check that x turns towards y with the rotor, the sign of x and y, or x and y exchanged."
        )
        yield Finding("warning", "against-rotation", text, rows_of(np.isin(test.run, aside)))


def _runs(test: StaticTest, at_load: Bool, part: Float) -> list[str]:
    """Runs in which a part of the positions is negative under every load and more than a share of them."""
    found = []
    fewest_loads = 3  # loads of a run from which their positions say a direction
    # Share of the positions that is more than noise and a probe a few degrees off, all loads agreeing
    largest_share_aside = 0.05
    for run in test.runs:
        here = at_load & (test.run == run)
        beyond = -float(part[here].sum()) > largest_share_aside * float(np.abs(test.displacement[here]).sum())
        if here.sum() >= fewest_loads and (part[here] < 0).all() and beyond:
            found.append(run)
    return found
