"""Readings that no fit can follow: beyond the clearance, of which many mean a wrong unit, and before a jump."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.digits import significant
from rotorfit.estimators.blocks.row_keys import combined, rows_by
from rotorfit.estimators.noise.sweep_noise import FEWEST_LINES
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.observing.rows import LARGEST_MEASURED_ECCENTRICITY
from rotorfit.models import RotorModel
from rotorfit.models.motion.journal import Journal, journals


def _within_clearance(seat: Journal, test: Experiment) -> tuple[Experiment, str]:
    """A test without the few readings that no journal within its clearance can have made, and a sentence on them. All
    readings of such a line go: they would be compared with a wrong orbit. Where there are many, the test is left as it
    is, and is refused when it is observed."""
    clearance = seat.clearance
    size = test.excursion(seat.plane, clearance)
    beyond = size > LARGEST_MEASURED_ECCENTRICITY * clearance
    slips_share = 0.05  # share of a test's readings that may be slips of the instruments
    if not 0 < np.count_nonzero(beyond) <= max(1.0, slips_share * np.isfinite(size).sum()):
        return test, ""
    line = test.same_place
    out = np.isin(line, line[beyond])
    where = [
        (k, f"{significant(test.frequencies[k], 4)} rad/s" if test.swept else f"row {k + 1}")
        for k in np.flatnonzero(beyond)
    ]
    places = sorted({f"{test.run[row]}, {place}" for row, place in where})
    named = "; ".join(places[:3]) + (f" and {len(places) - 3} more" if places[3:] else "")
    return test.select(~out), (
        f"{test.source or test.title}: {np.count_nonzero(beyond)} of {np.isfinite(size).sum()} readings of the journal "
        f"lie beyond the clearance of {significant(clearance * 1e6, 4)} um, up to "
        f"{significant(np.nanmax(size) * 1e6, 4)} um, and are left out ({named})"
    )


def usable(model: RotorModel, test: Experiment) -> tuple[Experiment, tuple[str, ...]]:
    """A test as it can be fitted, and sentences on the readings that were left out."""
    if not model.eccentricity_dependent or model.frame != "z":
        return test, ()
    said = []
    for seat in journals(model):
        for part in (_within_clearance, _off_jumps):
            test, sentence = part(seat, test)
            said.append(sentence)
    return test, tuple(filter(None, said))


def _off_jumps(seat: Journal, given: Experiment) -> tuple[Experiment, str]:
    """A test without the last two lines before each jump of a sweep, and a sentence: the orbit's slopes are infinite at
    a branch's end, where a search stalls. Lines are taken to be in the order swept."""
    test = given.perturbation
    if test is None:
        return given, ""
    moving = np.flatnonzero(test.plane == seat.plane)
    if test.static_position is not None or not moving.size:
        return test, ""
    sweep = combined(
        test.alike("run", "set_speed", "force_plane", "direction")[1], (np.sign(test.frequency) + 1).astype(np.intp)
    )
    ending: list[int] = []
    jumps = 0
    least_step = 0.05  # step of the journal's vector from one line to the next, in clearances, that may be a jump
    step_ratio = 4.0  # times the steps on either side of it
    lines_before = 2  # lines left out before a jump
    for rows in (moving[own] for own in rows_by(sweep[moving]) if own.size >= FEWEST_LINES):
        step = np.abs(np.diff(test.response[rows])) / seat.clearance
        beside = np.maximum(np.append(step[1:], 0.0), np.append(0.0, step[:-1]))
        places = np.flatnonzero((step > least_step) & (step > step_ratio * beside) & _swept_on(test, rows)).tolist()
        jumps += len(places)
        ending += [row for place in places for row in rows[max(place + 1 - lines_before, 0) : place + 1].tolist()]
    if not ending:
        return test, ""
    line = test.same_place
    out = np.isin(line, line[ending])
    return test.select(~out), (
        f"{test.source or test.title}: {jumps} jump{'s' * (jumps > 1)} from one orbit to another; the "
        f"last {lines_before} lines before each, where the orbit left ceases to exist, are left out"
    )


def _swept_on(test: PerturbationTest, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
    """True if from each row to the next the sweep went on: a step in frequency as the others, and the same force."""
    ahead, force = np.diff(test.frequency[rows]), np.abs(test.force[rows])
    usual = float(np.median(ahead))
    largest_force_change = 0.2  # relative change of the force from line to line, within one sweep
    same = np.abs(np.diff(force)) <= largest_force_change * force[:-1]
    largest_sweep_gap = 3.0  # step of the frequency over the usual one, within one sweep
    return np.asarray((ahead * usual > 0) & (np.abs(ahead) <= largest_sweep_gap * abs(usual)) & same)
