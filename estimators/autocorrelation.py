"""Integrated autocorrelation time of chains: how many steps one independent draw takes."""

from __future__ import annotations

import numpy as np

from rotorfit.models.array_types import Float

_WINDOW = 5.0  # autocorrelation times summed over: beyond them there is noise (Sokal 1997, as emcee takes it)
_DISAGREE = 4.0  # spread of 32 means over its expectation, beyond all chance (chi-squared over 31: p < 1e-12)


def autocorrelation_time(chain: Float) -> Float:
    """Integrated autocorrelation time of each entry in steps, at least one, infinite where nothing moves.

    Each walker is measured from its own mean, so walkers that are stuck in places of their own look well mixed: where
    their means differ by much more than that time allows, the time that explains the difference takes its place.

    Args:
        chain: walkers' positions, shape ``(steps, walkers, p)``.
    """
    still = np.ptp(chain, axis=0).max(axis=0) == 0
    tau = np.full(chain.shape[2], np.inf)
    if (~still).any():
        # Centred and scaled, so that products keep their digits.
        moving = chain[:, :, ~still]
        moving = (moving - moving.mean(axis=(0, 1))) / moving.std(axis=(0, 1))
        inner = _within(moving)
        between = chain.shape[0] * moving.mean(axis=0).var(axis=0, ddof=1)
        tau[~still] = np.where(between > _DISAGREE * np.maximum(inner, 1.0), between, inner)
    return np.where(np.isfinite(tau), np.maximum(tau, 1.0), np.inf)


def _within(chain: Float) -> Float:
    """Time by the autocorrelation of each walker about its own mean, averaged over walkers; NaN if one never moves."""
    steps = chain.shape[0]
    length = 1 << (2 * steps - 1).bit_length()  # zeros behind, so that the end does not meet the beginning
    power = np.abs(np.fft.rfft(chain - chain.mean(axis=0), n=length, axis=0)) ** 2
    products = np.fft.irfft(power, n=length, axis=0)[:steps]
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = (products / products[0]).mean(axis=1)
    times = 2.0 * np.cumsum(correlation, axis=0) - 1.0
    beyond = np.arange(steps)[:, None] >= _WINDOW * times
    window = np.where(beyond.any(axis=0), beyond.argmax(axis=0), steps - 1)
    return np.asarray(times[window, np.arange(times.shape[1])])
