"""Verdicts on what data determine, on Jacobians whose null space is known, and against the analysis of the rotor."""

from __future__ import annotations

import re

import numpy as np
import pytest
from sentences import hear

from rotorfit.estimators.inference.identifiability import covariance, diagnose, natural_scales
from rotorfit.models import BLOCKS, OneMode, WhirlWhip
from rotorfit.models.structure import block_parameters

NAMES = ("M", "K", "K0", "D")


def verdict(jacobian, values=(1.0, 8000.0, 9000.0, 450.0)):
    values = np.array(values)
    J = np.asarray(jacobian, dtype=float)
    return diagnose(OneMode(), NAMES, NAMES, values, J, np.abs(values))


def test_full_rank_covariance_is_the_inverse():
    rng = np.random.default_rng(0)
    J = rng.normal(size=(30, 4)) / np.array([0.01, 10.0, 20.0, 1.0])
    covar, found = verdict(J)
    np.testing.assert_allclose(covar, np.linalg.inv(J.T @ J), rtol=1e-9)
    assert found.rank == found.size == 4
    assert found.combinations == ()
    scaled = J * np.array([1.0, 8000.0, 9000.0, 450.0])
    assert found.condition == pytest.approx(np.linalg.cond(scaled), rel=1e-6)


@pytest.mark.parametrize(
    ("mix", "message"),
    [
        ((1.0, 1.0), r"K \+ K0 only as a sum"),
        ((1.0, -1.0), "K - K0 only as a difference"),
        ((1 / 8000.0, 1 / 9000.0), r"K \* K0 only as a product"),
        ((1 / 8000.0, -1 / 9000.0), "K / K0 only as a ratio"),
    ],
)
def test_pairs_in_words(mix, message):
    """The data see only a K + b K0 (or its logarithmic counterpart): one direction stays open."""
    rng = np.random.default_rng(1)
    seen = rng.normal(size=(30, 1)) / 0.01
    level = np.max(np.abs(mix)) * 10
    J = np.hstack(
        [rng.normal(size=(30, 1)) * 100, seen * mix[0] / level, seen * mix[1] / level, rng.normal(size=(30, 1))]
    )
    covar, found = verdict(J)
    assert found.rank == 3
    assert set(found.unresolved) == {"K", "K0"}
    (combination,) = found.combinations
    assert re.search(message, combination.message)
    # What the data do see keeps its variance.
    mixed = np.array([0, mix[0], mix[1], 0])
    assert mixed @ covar @ mixed > 0


def test_a_silent_parameter_is_not_observable():
    rng = np.random.default_rng(2)
    J = rng.normal(size=(30, 4)) * 100
    J[:, 3] = 0.0
    _, found = verdict(J)
    assert found.unresolved == ("D",)
    hear(found.combinations[0].message)
    assert not np.isfinite(found.condition)


def test_scales_do_not_change_the_verdict():
    """Units of the parameters are arbitrary: rank and directions survive scaling by twelve orders of magnitude."""
    rng = np.random.default_rng(3)
    J = rng.normal(size=(30, 4)) * 10
    J[:, 2] = J[:, 1]
    for scale in (np.ones(4), np.array([1e-6, 1.0, 1.0, 1e6])):
        _, stderr, _, open_ = covariance(J / scale, scale)
        assert open_.sum() == 1
        assert np.isinf(stderr).sum() == 1


def test_every_structural_block_has_a_size_that_would_matter():
    """A tenth of the stiffness level over a power of the frequency: kg s^n is N/m over w^(n + 2)."""
    model, stiffness, frequency = WhirlWhip(blocks=BLOCKS), 3e4, 500.0
    power = {"N s/m": 1, "kg": 2, "kg s": 3, "kg s^2": 4, "kg s^4": 6}
    names = [p.name for p in block_parameters(BLOCKS, 2)]
    found = natural_scales(model, names, np.zeros(len(names)), stiffness, frequency)
    expected = [0.1 * stiffness / frequency ** power[model.parameter(name).unit] for name in names]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
