"""The crack monitor: turning anisotropy dK/K of dated tests of one shaft, for :func:`rotorfit.trend`."""

from __future__ import annotations

import math

from rotorfit.fitting.result import FitResult
from rotorfit.monitoring.trend import DatedValues

PLACE = "turning anisotropy"
"""Place of these values in a trend."""
RATIO = "dK/K"


def dated_anisotropy(fit: FitResult, date: str = "") -> DatedValues:
    """dK/K of a fit, or dK where there is no one K, as a value to follow: a crack that propagates makes it grow.

    ``rf.trend([rf.dated_anisotropy(fit, date) for fit, date in zip(fits, dates)])`` says whether it did.

    Args:
        fit: of a model with the parameters dK_cos and dK_sin, such as :class:`rotorfit.models.AnisotropicShaft`.
        date: ISO 8601; by default the attribute ``date`` of the test, and empty without one.

    Raises:
        ValueError: a model without turning anisotropy, a test that does not determine it, or tests of several dates.
    """
    sources = [experiment.source for experiment in fit.experiments if experiment.source]
    where = ", ".join(sources) or "the fit"
    found = fit.turning_anisotropy()
    whole = math.isfinite(found.ratio.value)
    name, value = (RATIO, found.ratio) if whole else ("dK", found.dK)
    if not found.dK.stderr < math.inf:
        raise ValueError(f"{where} does not determine dK/K: the image at 2 Om - w, or the 2x line, was not measured")
    return DatedValues(
        date=date or _date_of(fit, where),
        values={name: (value.value, value.stderr)},
        units={name: value.unit},
        place=PLACE,
        source=where,
    )


def _date_of(fit: FitResult, where: str) -> str:
    dates = {str(d) for e in fit.experiments if "date" in e.attributes for d in set(e.attributes["date"].tolist())}
    if len(dates) > 1:
        raise ValueError(f"{where} has tests of several dates: {', '.join(sorted(dates))}; fit each date by itself")
    return dates.pop() if dates else ""
