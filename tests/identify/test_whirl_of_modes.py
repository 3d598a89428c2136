"""Modes in x and y by the sense of their orbits, against the same rotor in z = x + j y, where the sign says it."""

from __future__ import annotations

import numpy as np
import pytest
from plain import plain_fit
from synthetic import SPEEDS, circular_test

import rotorfit as rf
from rotorfit.models import Anisotropic, eigenvalues
from rotorfit.models.motion.stability import whirl_sense


def test_each_mode_of_a_fit_in_x_and_y_is_there_once_with_the_sign_of_its_whirl() -> None:
    """An isotropic rotor at one speed in 2 x 2 matrices: -j K of z is Kxy = -Kyx in x and y."""
    K, D, M, cross = 20e3, 60.0, 1.1, 2500.0
    roots = np.roots([M, D, K - 1j * cross])
    model = Anisotropic()
    values = dict.fromkeys(model.parameter_names, 0.0)
    values |= {"Kxx": K, "Kxy": cross, "Kyx": -cross, "Kyy": K, "Dxx": D, "Dyy": D, "Mxx": M, "Myy": M}
    true = model.vector(values)
    s = eigenvalues(model, true, 100.0)
    signed = whirl_sense(model, true, 100.0, s) * np.abs(s.imag)
    assert np.sort(signed) == pytest.approx(np.sort(np.repeat(roots.imag, 2)), rel=1e-9)
    test = circular_test(model, true, speeds=SPEEDS["anisotropic"], frequency=np.linspace(-300, 300, 80), noise=1e-4)
    fit = plain_fit(model, test)
    frequencies = [frequency.value for frequency, *_ in fit.natural_frequencies(100.0)]
    modes = [mode.frequency.value for mode in fit.modes(100.0)]
    for found in (frequencies, modes):
        assert sorted(found) == pytest.approx(sorted(roots.imag), rel=1e-3)
    judged = {mode.direction: mode.decrement for mode in fit.stability_report(max_speed_rpm=955).modes}
    decrements = -2 * np.pi * roots.real / np.abs(roots.imag)
    ways = np.where(roots.imag > 0, "forward", "backward").tolist()
    assert judged == pytest.approx(dict(zip(ways, decrements, strict=True)), rel=0.01)
    named = [text.get_text().split()[0] for text in fit.plot.stability().axes[0].texts]
    assert [name for name in named if name in ("1F", "1B", "2F", "2B")] == ["1B", "1F"]


def test_a_mode_that_does_not_oscillate_is_called_overdamped() -> None:
    """Its ratio is one, to more digits than anybody can use."""
    model = rf.models.OneMode()
    values = {"M": 1.2, "K": 8e3, "Ds": 2000.0, "K0": 9e3, "D": 4500.0, "lam": 0.0, "Mf": 0.4}
    rpm = np.linspace(-4000, 4000, 20)
    test = rf.simulate(model, values, speed_rpm=600, frequency_rpm=rpm, force=20.0, exact=True, seed=1)
    fit = rf.fit(model, test, known={name: values[name] for name in ("K", "Ds", "lam")})
    for table in (fit.natural_frequencies(60.0), fit.modes(60.0)):
        assert "overdamped" in str(table)
        assert "1.0000" not in str(table)
