"""Local estimates of frequency responses against the receptance of the rotor that was integrated in time."""

from __future__ import annotations

import numpy as np
import pytest
from swept import Sweep, two_modes

from rotorfit.estimators.local_response import gauss_nodes, local_response

RATE = 1024.0
OMEGA = 157.0


def spectra(signal: np.ndarray, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    w = 2 * np.pi * np.fft.fftfreq(signal.shape[-1], 1 / RATE)
    inside = (w >= low) & (w <= high)
    return w[inside], np.fft.fft(signal)[..., inside] / RATE


def estimate(duration: float, noise: float, rng: np.random.Generator, *, runout: float = 0.0, low=20.0, high=460.0):
    rotor, sweep = two_modes(), Sweep(10.0, 470.0, duration)
    count = int(duration * RATE)
    t = np.arange(count) / RATE
    z = rotor.motion(sweep.force, RATE, count)
    z = z + noise * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    orders = [np.exp(1j * n * (OMEGA * t + 0.02 * np.sin(3.1 * t))) for n in (1, 2)]
    z = z + runout * (orders[0] * 1j + 0.3 * orders[1])
    if runout:  # as done with records: the orders are taken out with amplitudes that the sweep disturbs
        basis = np.array(orders).T
        z = z - (basis @ np.linalg.lstsq(basis, z.T, rcond=None)[0]).T
    w, outputs = spectra(z, low, high)
    found = local_response(
        w, outputs, spectra(sweep.force(t), low, high)[1], [spectra(u, low, high)[1] for u in orders if runout]
    )
    return found, rotor.receptance(found.frequency)


def test_nodes_of_even_weights_are_those_of_legendre() -> None:
    """Lines at the midpoints of many equal cells have the moments of the interval to 1/(12 K^2) times a derivative."""
    lines = (np.arange(2000) + 0.5) / 1000 - 1
    # 3 nodes: derivative of a node to the second moment below 2, moments off by 1/(3 * 2000^2): 1e-7
    assert gauss_nodes(lines, np.ones(2000), 3) == pytest.approx(np.polynomial.legendre.leggauss(3)[0], abs=1e-6)


def test_sweep_of_ten_seconds_leaves_no_bias() -> None:
    """Nearly no noise: what is left is the degree of the polynomials.

    The least damped forward mode is 30 rad/s from the axis and the half-width of a narrowest band 2.8 rad/s: the
    Bernstein ellipse of the band has rho = 21, and what three nodes leave out is of the order rho^-4 = 5e-6 of H. Near
    both ends of the sweep its spectrum is as smooth as the transient: the two can hardly be told apart there, which
    sigma says once there is noise. Windows of whole turns are off by tens of per cent here.
    """
    found, truth = estimate(10.0, 1e-12, np.random.default_rng(0))
    error = np.abs(found.response - truth) / np.abs(truth)
    well_inside = (found.frequency > 120.0) & (found.frequency < 440.0)
    assert error[:, well_inside].max() < 1.5e-4
    assert error[:, found.frequency > 40.0].max() < 5e-3


@pytest.mark.parametrize("duration", [10.0, 30.0])
def test_errors_are_those_stated(duration: float) -> None:
    """Twelve records with noise: the rms of error over sigma is one within its sampling error and a little bias."""
    ratios = []
    for seed in range(12):
        found, truth = estimate(duration, 0.4e-6, np.random.default_rng(seed))
        error = (found.response - truth) / found.sigma
        ratios.append(np.concatenate([error.real, error.imag], axis=1))
    ratio = np.concatenate(ratios, axis=1)
    # 12 records of some 100 nodes: 1/sqrt(2 * 2400) = 1.4 %; the level is pooled from 60 lines: 1/(4 * 60) more
    assert np.sqrt(np.mean(ratio**2, axis=1)) == pytest.approx(1.0, abs=0.08)
    assert np.mean(np.abs(ratio) > 1.96) == pytest.approx(0.05, abs=0.02)


def test_nodes_of_a_band_are_uncorrelated() -> None:
    """Christoffel-Darboux: what makes the readings independent in a fit."""
    errors = []
    for seed in range(80):
        found, truth = estimate(10.0, 0.4e-6, np.random.default_rng(seed), low=300.0, high=306.0)
        errors.append(((found.response - truth) / found.sigma)[0])
    assert np.shape(errors) == (80, 3)
    correlation = np.corrcoef(np.array(errors), rowvar=False)
    # a mean of N products of unit complex numbers has sd 1/sqrt(N)
    assert np.abs(correlation[np.triu_indices(3, 1)]).max() < 3.5 / np.sqrt(80)


def test_orders_of_the_shaft_do_not_disturb_lines_away_from_them() -> None:
    """Run-out of 20 um beside a response of a few um: errors stay those stated 2 pi/T and more from the orders."""
    ratios = []
    for seed in range(6):
        found, truth = estimate(30.0, 0.4e-6, np.random.default_rng(seed), runout=20e-6)
        apart = np.abs(found.frequency[:, None] - OMEGA * np.array([1, 2])).min(axis=1) > 2 * np.pi / 30.0
        error = ((found.response - truth) / found.sigma)[:, apart]
        ratios.append(np.concatenate([error.real, error.imag], axis=1))
    ratio = np.concatenate(ratios, axis=1)
    assert np.sqrt(np.mean(ratio**2, axis=1)) == pytest.approx(1.0, abs=0.12)


def test_too_few_lines_are_refused() -> None:
    line = np.arange(7.0)
    with pytest.raises(ValueError, match="7 spectral lines lie in the tested band, 9 are needed"):
        local_response(line, np.ones((1, 7), complex), np.ones(7, complex))
