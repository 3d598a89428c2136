"""Readings beyond the clearance of a bearing: a few are left out and reported, many say that clearance or units err."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.experiments import (
    DisplacementTest,
    Experiment,
    ImpulseTest,
    PerturbationTest,
    StaticTest,
)
from rotorfit.models import RotorModel
from rotorfit.models.array_types import Float
from rotorfit.models.motion.journal import journal
from rotorfit.observing.refusals import LARGEST_MEASURED_ECCENTRICITY
from rotorfit.observing.row_labels import same_rows

_SLIPS_SHARE = 0.05  # share of a test's readings that may be slips of the instruments


def within_clearance(model: RotorModel, test: Experiment) -> tuple[Experiment, str]:
    """A test without the few readings that no journal within its clearance can have made, and a sentence on them.

    All readings of such a line go: they would be compared with a wrong orbit. Where there are many, the test is left as
    it is, and is refused when it is observed.
    """
    if model.clearance is None or not model.eccentricity_dependent:
        return test, ""
    size = _excursion(model, test)
    beyond = size > LARGEST_MEASURED_ECCENTRICITY * model.clearance
    if not 0 < np.count_nonzero(beyond) <= max(1.0, _SLIPS_SHARE * np.isfinite(size).sum()):
        return test, ""
    line = same_line(test)
    out = np.isin(line, line[beyond])
    places = sorted({f"{run}, {_where(test, row)}" for row, run in enumerate(test.run.tolist()) if beyond[row]})
    named = "; ".join(places[:3]) + (f" and {len(places) - 3} more" if places[3:] else "")
    return test.select(~out), (
        f"{test.source or test.title}: {np.count_nonzero(beyond)} of {np.isfinite(size).sum()} readings of the journal "
        f"lie beyond the clearance of {model.clearance * 1e6:.4g} um, up to {np.nanmax(size) * 1e6:.4g} um, and are "
        f"left out ({named})"
    )


def _excursion(model: RotorModel, test: Experiment) -> Float:
    """How far the journal went by each reading, m, NaN where the reading is not of the journal."""
    clearance, place = model.clearance or np.nan, model.coordinates[journal(model).at].plane
    nothing = np.full(len(test), np.nan)
    match test:
        case PerturbationTest() if test.static_position is not None:
            return np.abs(test.static_position)
        case PerturbationTest():
            return np.where(
                (test.plane == place) & ~np.char.startswith(test.direction, "r"), np.abs(test.response), np.nan
            )
        case DisplacementTest():
            return np.where(test.plane == place, np.abs(test.displacement), np.nan)
        case StaticTest():
            return np.where(test.plane == place, np.abs(test.displacement), np.nan)
        case ImpulseTest():
            return np.where(np.isnan(test.eccentricity), np.abs(test.position), test.eccentricity * clearance)
    return nothing


def same_line(test: Experiment) -> NDArray[np.intp]:
    """Rows that share the journal's position."""
    match test:
        case PerturbationTest():
            return same_rows(test.run, test.set_speed, test.frequency, test.force_plane)
        case StaticTest():
            return same_rows(test.run, test.speed, test.load_plane, test.load.real, test.load.imag)
    return np.arange(len(test))


def _where(test: Experiment, row: int) -> str:
    if isinstance(test, PerturbationTest | DisplacementTest):
        return f"{test.frequency[row]:.4g} rad/s"
    return f"row {row + 1}"
