"""Local estimates of frequency responses against the receptance of the rotor that was integrated in time."""

from __future__ import annotations

import numpy as np
import pytest
from sentences import refuses
from slow_cases import slow_but
from swept import Rotor, Sweep, two_modes

from rotorfit.estimators.signals.local_response import (
    SMOOTH_DEGREE,
    RecordSpectra,
    _between_tones,
    gauss_nodes,
    local_response,
)

RATE = 1024.0
OMEGA = 157.0


def spectrum(signals: np.ndarray) -> np.ndarray:
    return np.fft.fft(signals)[..., : signals.shape[-1] // 2] / RATE


def estimate(duration: float, noise: float, rng: np.random.Generator, *, runout: float = 0.0, low=20.0, high=460.0):
    """Response to the sweep found in a simulated record, and the true one at the same frequencies, ``(P, L)`` each."""
    rotor, sweep = two_modes(), Sweep(10.0, 470.0, duration)
    count = int(duration * RATE)
    t = np.arange(count) / RATE
    z = rotor.motion(sweep.force, RATE, count)
    z = z + noise * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
    orders = np.array([np.exp(1j * n * (OMEGA * t + 0.02 * np.sin(3.1 * t))) for n in (1, 2)])
    z = z + runout * (orders[0] * 1j + 0.3 * orders[1])
    if runout:  # as done with records: the orders are taken out with amplitudes that the sweep disturbs
        z = z - (orders.T @ np.linalg.lstsq(orders.T, z.T, rcond=None)[0]).T
    record = RecordSpectra(
        frequency=2 * np.pi * RATE / count * np.arange(count // 2),
        outputs=spectrum(z),
        forces=spectrum(sweep.force(t))[None],
        others=spectrum(orders if runout else orders[:0]),
    )
    found = local_response([record], low, high)
    return found.frequency, found.response[0], found.sigma[0], rotor.receptance(found.frequency)


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
    w, found, _, truth = estimate(10.0, 1e-12, np.random.default_rng(0))
    error = np.abs(found - truth) / np.abs(truth)
    well_inside = (w > 120.0) & (w < 440.0)
    assert error[:, well_inside].max() < 1.5e-4
    assert error[:, w > 40.0].max() < 5e-3


@pytest.mark.parametrize("duration", slow_but([10.0, 30.0], 30.0))
def test_errors_are_those_stated(duration: float) -> None:
    """Two minutes of records: the rms of error over sigma is one within its sampling error and a little bias."""
    ratios = []
    for seed in range(round(120 / duration)):
        _, found, sigma, truth = estimate(duration, 0.4e-6, np.random.default_rng(seed))
        error = (found - truth) / sigma
        ratios.append(np.concatenate([error.real, error.imag], axis=1))
    ratio = np.concatenate(ratios, axis=1)
    # 12 records of some 100 nodes, or 4 of 300: 1/sqrt(2 * 2400) = 1.4 %; the level is pooled from 60 lines:
    # 1/(4 * 60) more
    assert np.sqrt(np.mean(ratio**2, axis=1)) == pytest.approx(1.0, abs=0.08)
    assert np.mean(np.abs(ratio) > 1.96) == pytest.approx(0.05, abs=0.02)


def test_nodes_of_a_band_are_uncorrelated() -> None:
    """Christoffel-Darboux: what makes the readings independent in a fit."""
    errors = []
    for seed in range(80):
        _, found, sigma, truth = estimate(10.0, 0.4e-6, np.random.default_rng(seed), low=300.0, high=306.0)
        errors.append(((found - truth) / sigma)[0])
    assert np.shape(errors) == (80, 3)
    correlation = np.corrcoef(np.array(errors), rowvar=False)
    # a mean of N products of unit complex numbers has sd 1/sqrt(N)
    assert np.abs(correlation[np.triu_indices(3, 1)]).max() < 3.5 / np.sqrt(80)


def test_orders_of_the_shaft_do_not_disturb_lines_away_from_them() -> None:
    """Run-out of 20 um beside a response of a few um: errors stay those stated 2 pi/T and more from the orders."""
    ratios = []
    for seed in range(3):  # some 300 nodes each: 1/sqrt(2 * 1800) = 1.7 %
        w, found, sigma, truth = estimate(30.0, 0.4e-6, np.random.default_rng(seed), runout=20e-6)
        apart = np.abs(w[:, None] - OMEGA * np.array([1, 2])).min(axis=1) > 2 * np.pi / 30.0
        error = ((found - truth) / sigma)[:, apart]
        ratios.append(np.concatenate([error.real, error.imag], axis=1))
    ratio = np.concatenate(ratios, axis=1)
    assert np.sqrt(np.mean(ratio**2, axis=1)) == pytest.approx(1.0, abs=0.12)


@pytest.mark.slow
def test_start_ups_with_the_weight_at_opposite_places_are_differenced_in_one_fit() -> None:
    """Residual unbalance ten times the weight, the same in both records, is a second response and leaves the first."""
    rotor, rate, ratios = two_modes(), RATE, []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        records = []
        for sign, last in ((1.0, 465.0), (-1.0, 471.0)):  # no two start-ups are alike
            sweep, residual = Sweep(10.0, last, 20.0), 10 * np.exp(0.7j)
            count = int(20.0 * rate)
            z = rotor.motion(lambda t, s=sweep, g=sign + residual: g * s.force(t), rate, count)
            z = z + 0.4e-6 * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
            force = spectrum(sweep.force(np.arange(count) / rate))
            line = 2 * np.pi * rate / count * np.arange(count // 2)
            records.append(
                RecordSpectra(
                    frequency=line,
                    outputs=spectrum(z),
                    forces=np.array([sign * force, force]),
                    others=np.zeros((0, line.size), complex),
                )
            )
        found = local_response(records, 30.0, 450.0)
        error = (found.response[0] - rotor.receptance(found.frequency)) / found.sigma[0]
        ratios.append(np.concatenate([error.real, error.imag], axis=1))
    assert np.sqrt(np.mean(np.concatenate(ratios, axis=1) ** 2, axis=1)) == pytest.approx(1.0, abs=0.1)


def test_too_few_lines_are_refused() -> None:
    line = np.arange(7.0)
    one = np.ones((1, 7), complex)
    with refuses(ValueError):
        local_response([RecordSpectra(frequency=line, outputs=one, forces=one, others=one)], 0.0, 6.0)


def test_pole_of_a_resonance_narrower_than_the_bands_is_found_and_followed() -> None:
    """A mode that decays at 2 rad/s under a sweep of 10 s: the narrowest bands, 5.7 rad/s, are wider than its peak.

    Polynomials would be off by tens of per cent of the peak; with the pole in the basis errors are those stated.
    """
    rotor = Rotor(np.array([-2.0 + 250.0j, -30.0 + 90.0j]), np.array([[0.01 - 0.02j, 0.03 + 0.01j]]))
    sweep, count = Sweep(10.0, 470.0, 10.0), int(10 * RATE)
    ratios = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        z = rotor.motion(sweep.force, RATE, count)
        z = z + 0.4e-6 * (rng.standard_normal(z.shape) + 1j * rng.standard_normal(z.shape))
        force = spectrum(sweep.force(np.arange(count) / RATE))[None]
        line = 2 * np.pi * RATE / count * np.arange(count // 2)
        record = RecordSpectra(frequency=line, outputs=spectrum(z), forces=force, others=force[:0])
        found = local_response([record], 30.0, 450.0)
        near = np.abs(found.frequency - 250.0) < 20.0
        ratios.append(((found.response[0] - rotor.receptance(found.frequency)) / found.sigma[0])[:, near].ravel())
    ratio = np.concatenate(ratios)
    assert np.sqrt(np.mean(np.abs(ratio) ** 2) / 2) == pytest.approx(1.0, abs=0.25)


def spectra_of(force: np.ndarray, rate: float) -> list[RecordSpectra]:
    w = 2 * np.pi * np.fft.rfftfreq(force.size, 1 / rate)
    none = np.zeros((0, w.size), dtype=complex)
    return [RecordSpectra(frequency=w, outputs=none, forces=np.fft.rfft(force)[None], others=none)]


@pytest.mark.parametrize("seconds", [2.0, 6.0, 30.0])
@pytest.mark.parametrize("shape", ["linear", "logarithmic", "growing"])
def test_pieces_of_a_sweep_are_no_tones(seconds: float, shape: str) -> None:
    """A short sweep's spectrum ripples, and the force of an unbalance grows with the square of the speed."""
    rate, first, last = 500.0, 5.0, 25.0
    t = np.arange(int(seconds * rate)) / rate
    turns = first * t + (last - first) * t**2 / (2 * seconds)
    if shape == "logarithmic":
        turns = first * seconds / np.log(last / first) * ((last / first) ** (t / seconds) - 1)
    force = np.cos(2 * np.pi * turns) * (np.gradient(turns, t) ** 2 if shape == "growing" else 1.0)
    edges = np.linspace(20.0, 180.0, 9)
    assert np.array_equal(_between_tones(spectra_of(force, rate), edges), edges)


@pytest.mark.parametrize("step", [0.5, 1.0])
def test_bands_lie_between_tones_of_a_multisine(step: float) -> None:
    rate, tones = 500.0, np.arange(6.0, 30.0, step)
    t = np.arange(int(40 * rate)) / rate
    phase = np.pi * np.arange(tones.size) ** 2 / tones.size
    force = np.cos(2 * np.pi * tones[:, None] * t + phase[:, None]).sum(axis=0)
    edges = np.linspace(2 * np.pi * 5.9, 2 * np.pi * 30.1, 400)
    found = _between_tones(spectra_of(force, rate), edges) / (2 * np.pi)
    held = np.histogram(tones, found)[0]
    assert (held[:-1] == SMOOTH_DEGREE + 1).all()
    assert held.sum() == tones.size
