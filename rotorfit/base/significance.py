"""Significance: the probabilities by which estimates and residuals are judged, and quantiles of Student's t."""

from __future__ import annotations

import math
from statistics import NormalDist

P_CHANCE = 0.05
"""Probability up to which something is held to be no chance where single quantities are judged. Chosen, as usual."""
CHANCE_ERRORS = NormalDist().inv_cdf(1 - P_CHANCE / 2)
"""Standard errors that chance alone exceeds so often: the half-width of a 95 % band."""

P_UNLIKELY = 0.01
"""The same where a description is given up for one with more values: noise of its own for each sweep, a fixed cause in
place of runs that differ at random. Chosen."""
P_WARNING = 0.001
"""Probability of a warning, and of a cause, of a fit that misses nothing. Chosen: one false warning in a thousand."""

P_FALSE_ALARM = 6e-5
"""The same where many are judged at once, as bands, runs and starts: some hundred raise a false alarm once in a hundred
times. Chosen."""
SIGNIFICANT_ERRORS = NormalDist().inv_cdf(1 - P_FALSE_ALARM / 2)
"""Standard errors that chance alone exceeds so often: 4."""

OPEN_ERRORS = 3.0
"""Standard errors within which another value is not ruled out: chance alone exceeds them once in 370 times. Chosen."""


def quantile(level: float, freedom: float) -> float:
    """Standard errors on either side of an estimate of an interval: Student's t, normal if ``freedom`` is infinite."""
    reach = (1 + level) / 2
    if not math.isfinite(freedom):
        return NormalDist().inv_cdf(reach)
    from scipy.special import stdtrit  # late: loading it takes longer than a fit

    return float(stdtrit(freedom, reach))
