"""Readings told as displacements that went through something first: a filter, an integrator, a latency."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from rotorfit.checks.probe_filters import FilteredProbe
from rotorfit.data.channel_filters import CHANNEL_FILTERS, POWERS, ChannelFilter, values_to_try
from rotorfit.fitting.slips.readings import PLAINLY, Found, Hint, Readings, Trial, roughly_missed
from rotorfit.models.array_types import Bool, ComplexArray

_PROMISING = 0.5
"""Share of the misfit that a closed form near the right value leaves."""

_TRIED = 9  # values across the band; neighbours differ by less than a filter can be told by
_EVALUATIONS = 10  # of the search between the neighbours of the best
_MOST_PLANES = 4


def filter_slips(
    readings: Readings,
    trial: Trial,
    missed: float,
    hint: Hint,
    uneven: Callable[[], Mapping[str, FilteredProbe | None]],
) -> Iterator[Found]:
    """What explains the data among filters of all probes, of those at one plane, and of one of a pair."""
    yield from _of_group(readings, "all readings", np.ones(readings.plane.size, dtype=bool), trial, missed, hint)
    planes = np.unique(readings.plane).tolist()
    for plane in planes[:_MOST_PLANES]:
        rows = readings.plane == plane
        if not any(hint(_column(rows, kind.slope(readings.s))) for kind in CHANNEL_FILTERS):
            continue
        if plane not in uneven():
            if len(planes) > 1:
                yield from _of_group(readings, f"the readings at {plane}", rows, trial, missed, hint)
        elif (one := uneven()[plane]) is not None:
            # Forward in z = x + jy half of a filtered probe is left beside the whole of the other one.
            apart = readings.axis[rows] == one.probe
            half = (1 + one.seen(readings.s)) / 2
            rows &= (readings.axis == one.probe) if apart.any() else True
            factor = np.where(rows, one.seen(readings.s) if apart.any() else half, 1.0)
            told = f"the readings of the {one.probe} probe at {plane} are {one.told}. {one.mend}"
            yield Found(left=trial(readings.mended(factor))[0] / missed, told=told)


def _column(rows: Bool, log: ComplexArray) -> ComplexArray:
    return np.where(rows, log, 0.0)[:, None]


def _of_group(readings: Readings, who: str, rows: Bool, trial: Trial, missed: float, hint: Hint) -> Iterator[Found]:
    whole = readings.s / readings.middle
    least = np.inf
    if hint(_column(rows, np.log(whole))):
        for power, (told, mend) in POWERS.items():
            left = trial(readings.mended(np.where(rows, whole**power, 1.0)))[0] / missed
            least = min(left, least)
            yield Found(left=left, told=f"{who} are {told}. {mend}")
    for kind in CHANNEL_FILTERS if least > PLAINLY else ():
        if hint(_column(rows, kind.slope(readings.s))):
            yield from _searched(readings, kind, who, rows, trial, missed)


def _searched(
    readings: Readings, kind: ChannelFilter, who: str, rows: Bool, trial: Trial, missed: float
) -> Iterator[Found]:
    def mended(value: float) -> ComplexArray:
        return np.where(rows, kind.seen(readings.s, value), 1.0)

    tried = values_to_try(kind, readings.frequency, _TRIED)
    rough = [roughly_missed(readings.mended(mended(value))) for value in tried.tolist()]
    best = int(np.argmin(rough))
    if not 0 < best < tried.size - 1 or rough[best] > _PROMISING * missed:
        return  # at an end it is no corner but a power of the frequency, or nothing
    from scipy.optimize import minimize_scalar  # late: loading it takes longer than a fit

    found = minimize_scalar(
        lambda log: trial(readings.mended(mended(float(np.exp(log)))))[0],
        bounds=np.log(tried[[best - 1, best + 1]]),
        method="bounded",
        options={"maxiter": _EVALUATIONS},
    )
    value = kind.in_words(float(np.exp(found.x)))
    told, mend = kind.told.format(value=value), kind.mend.format(value=value)
    yield Found(left=float(found.fun) / missed, told=f"{who} are {told}. {mend}", free=1)
