"""Figure of a prediction: amplitude and phase with the band of the mean and that of a new reading."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rotorfit.models.digits import significant
from rotorfit.plots.style import (
    PHASE_LABEL,
    amplitude_unit,
    decade_ticks,
    grid,
    legend_below,
    length,
    literal,
    looked,
    per_rad_s,
    rate_unit,
    rate_words,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rotorfit.uncertainty.prediction import Prediction


@looked
def plot_prediction(prediction: Prediction) -> Figure:
    """Amplitude and phase lead against the frequency of the force, or against speed where it is once per turn."""
    synchronous = np.array_equal(prediction.frequency, prediction.speed)
    speeds = np.unique(prediction.speed)
    at = "" if synchronous or speeds.size > 1 else f", {rate_words(speeds[0])}"
    title = literal(f"Predicted response at {prediction.plane}, force at {prediction.force_plane}{at}")
    figure, axes = grid(2, 1, title, size=(6.2, 2.4), one_abscissa=True)
    amplitude, phase = axes[:, 0]
    order = np.argsort(prediction.frequency, kind="stable")
    x = prediction.frequency[order] * per_rad_s()
    seen = prediction.seen[order]
    scale, unit = (1e6, "µrad") if prediction.direction.startswith("r") else length()
    size, angle = np.abs(seen) * scale, np.unwrap(np.angle(seen))
    what = "of the whole curve" if prediction.whole else "at each frequency"
    floor = size.min() / 2  # of the panel, to which a band reaches that holds zero
    for band, label, shade in (
        (prediction.band_new, "a new reading", 0.15),
        (prediction.band, "the mean", 0.4),
    ):
        if not np.isfinite(band.amplitude).all():
            continue
        words = f"{significant(100 * prediction.level, 4)} % band of {label}, {what}"
        low, high = band.amplitude[order].T * scale
        amplitude.fill_between(x, np.maximum(low, floor), high, color="C0", alpha=shade, lw=0, label=words)
        half = np.diff(band.phase[order], axis=1)[:, 0] / 2
        phase.fill_between(x, np.rad2deg(angle - half), np.rad2deg(angle + half), color="C0", alpha=shade, lw=0)
    amplitude.plot(x, size, "-", lw=1.2, color="C0", label="predicted")
    phase.plot(x, np.rad2deg(angle), "-", lw=1.2, color="C0")
    amplitude.set_yscale("log")
    amplitude.set_ylim(bottom=floor)
    decade_ticks(amplitude.yaxis)
    amplitude.set_ylabel(f"amplitude, {amplitude_unit(unit)}")
    phase.set_ylabel(PHASE_LABEL)
    phase.set_ylim(max(phase.get_ylim()[0], -540), min(phase.get_ylim()[1], 540))
    phase.set_xlabel(f"{'speed' if synchronous else 'frequency of the force'}, {rate_unit()}")
    legend_below(figure)
    return figure
