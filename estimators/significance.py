"""Significance: the probabilities by which estimates and residuals are judged, and their quantiles."""

from __future__ import annotations

from statistics import NormalDist

P_CHANCE = 0.05
"""Probability up to which something is held to be no chance where single quantities are judged. Chosen, as usual."""
CHANCE_ERRORS = NormalDist().inv_cdf(1 - P_CHANCE / 2)
"""Standard errors that chance alone exceeds so often: the half-width of a 95 % band."""

P_FALSE_ALARM = 6e-5
"""The same where many are judged at once, as bands, runs and starts: some hundred raise a false alarm once in a hundred
times. Chosen."""
SIGNIFICANT_ERRORS = NormalDist().inv_cdf(1 - P_FALSE_ALARM / 2)
"""Standard errors that chance alone exceeds so often: 4."""
