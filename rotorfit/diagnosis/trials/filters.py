"""Readings that went through something before they were taken for displacements: a filter, an integrator, a latency."""

from __future__ import annotations

from collections.abc import Collection, Iterator

import numpy as np

from rotorfit.diagnosis.probe_filters import CHANNEL_FILTERS, POWERS, ChannelFilter, values_to_try
from rotorfit.diagnosis.trials.trial_fits import (
    EXPLAINED_MISFIT_SHARE,
    MOST_PLANES,
    PROMISING_MISFIT_SHARE,
    Explanation,
    Hint,
    Readings,
    trial,
)
from rotorfit.models.array_types import Bool, ComplexArray


def filters(readings: Readings, missed: float, hint: Hint, uneven: Collection[str]) -> Iterator[Explanation]:
    """Explanations of the data by filters of all probes and of those at one plane, unless its probes differ."""
    planes = np.unique(readings.plane).tolist()
    groups = [("all readings", np.ones(readings.plane.size, dtype=bool))]
    some = [plane for plane in planes[:MOST_PLANES] if plane not in uneven] if len(planes) > 1 else []
    groups += [(f"the readings at {plane}", readings.plane == plane) for plane in some]
    whole = readings.s / readings.middle
    for who, rows in groups:
        least = np.inf
        if hint(np.where(rows, np.log(whole), 0.0)[:, None]):
            for power, (code, what, undo) in POWERS.items():
                left = trial(readings.corrected(np.where(rows, whole**power, 1.0)))[0] / missed
                least = min(left, least)
                yield Explanation(left=left, code=code, message=f"{who} are {what}", undo=undo)
        for kind in CHANNEL_FILTERS if least > EXPLAINED_MISFIT_SHARE else ():
            if hint(np.where(rows, kind.slope(readings.s), 0.0)[:, None]):
                yield from _searched(readings, kind, who, rows, missed)


def _searched(readings: Readings, kind: ChannelFilter, who: str, rows: Bool, missed: float) -> Iterator[Explanation]:
    def factor(value: float) -> ComplexArray:
        return np.where(rows, kind.seen(readings.s, value), 1.0)

    count = 9  # values across the band; neighbours differ by less than filters can be distinguished by
    tried = values_to_try(kind, readings.frequency, count)
    rough = [trial(readings.corrected(factor(value)), search=False)[0] for value in tried.tolist()]
    best = int(np.argmin(rough))
    if not 0 < best < tried.size - 1 or rough[best] > PROMISING_MISFIT_SHARE * missed:
        return  # at an end it is no corner but a power of the frequency, or nothing
    from scipy.optimize import minimize_scalar  # late: loading it takes longer than a fit

    found = minimize_scalar(
        lambda log: trial(readings.corrected(factor(float(np.exp(log)))))[0],
        bounds=np.log(tried[[best - 1, best + 1]]),
        method="bounded",
        options={"maxiter": 10},
    )
    what, undo = kind.words(float(np.exp(found.x)))
    left = float(found.fun) / missed
    yield Explanation(left=left, code=kind.code, message=f"{who} are {what}", undo=undo, free=1)
