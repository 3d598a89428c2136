"""One rule from redchi and its sampling error to whether a model explains the data to within their noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from plain import plain_fit
from synthetic import MODELS, SPEEDS, TYPICAL, circular_test, covering_frequencies, known_of

from rotorfit.identify.fitting.noise.record import NoiseVerdict
from rotorfit.identify.fitting.noise.residual_study import ResidualStudy, largest_redchi
from rotorfit.identify.fitting.result import FitResult


def random_rig(seed: int, *, sigma_known: bool, quieter: float = 1.0) -> FitResult:
    """A fit of a rig with values off the typical ones by a fifth, its sigma stated too small by a factor."""
    rng = np.random.default_rng(seed)
    name = ("one-mode", "two-disk")[seed % 2]
    values = {key: value * np.exp(rng.normal(0, 0.2)) for key, value in TYPICAL[name].items()}
    values |= {key: 1.0 for key in ("beta1", "beta2") if key in values}
    model = MODELS[name]()
    theta = model.vector(values)
    w = covering_frequencies(model, theta, SPEEDS[name], int(rng.integers(20, 100)))
    test = circular_test(model, theta, speeds=SPEEDS[name], frequency=w, noise=0.01, seed=seed, sigma_known=sigma_known)
    if sigma_known:
        test = replace(test, sigma=test.sigma / quieter)
    return plain_fit(model, test, known=known_of(name, values))


@pytest.mark.parametrize("sigma_known", [True, False])
def test_noise_alone_stays_below_its_largest_redchi(sigma_known: bool) -> None:
    """A level of one in a thousand: of 24 rigs one may exceed it once in forty runs of other seeds."""
    fits = [random_rig(seed, sigma_known=sigma_known) for seed in range(24)]
    assert sum(fit.redchi > fit.largest_redchi for fit in fits) == 0


def test_noise_larger_than_given_exceeds_the_largest_redchi() -> None:
    """Sigma 1.35 times too small: redchi 1.8, where the fewest readings here (120 numbers) allow for 1.5."""
    fits = [random_rig(seed, sigma_known=True, quieter=1.35) for seed in range(24)]
    assert all(fit.redchi > fit.largest_redchi for fit in fits)
    assert not any(fit.model_limited for fit in fits)


def test_largest_redchi_grows_where_readings_follow_one_another() -> None:
    """Against noise made by a moving average, 4000 sets of 200 numbers: redchi exceeds it in one of a thousand."""
    rng = np.random.default_rng(0)
    white = rng.normal(size=(4000, 202))
    moved = (white[:, 2:] + white[:, 1:-1] + white[:, :-2]) / np.sqrt(3)
    study = ResidualStudy(verdict=NoiseVerdict.CORRELATED, lags=(2 / 3, 1 / 3))
    beyond = np.mean(np.mean(moved**2, axis=1) > largest_redchi(study, 200, np.inf))
    assert 0 < beyond < 0.004  # three errors of the count about 0.001, and the tail of correlated squares is longer
