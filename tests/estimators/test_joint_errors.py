"""Causes solved beside fitted values: shares, sizes of zero, whitened least squares, signs by trial of every set."""

from __future__ import annotations

from itertools import chain, combinations

import numpy as np
import pytest

from rotorfit.estimators.inference.joint_errors import (
    JointErrors,
    error_factor,
    joint_step,
    nearest_of_one_sign,
)

VALUES, CAUSES, READINGS = 4, 7, 60


class Linear:
    """A linear problem with columns of very different length, one cause nearly what a value does."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        parts = rng.normal(size=(2, READINGS, VALUES + CAUSES + 1))
        columns = parts[0] + 1j * parts[1]
        self.J = columns[:, :VALUES] * 10.0 ** rng.uniform(-3, 5, VALUES)
        self.B = columns[:, VALUES:-1].copy()
        self.B[:, 0] = self.J[:, 1] / np.linalg.norm(self.J[:, 1]) + 1e-6 * self.B[:, 0]
        self.size = 10.0 ** rng.uniform(-6, 3, CAUSES)
        self.B *= rng.uniform(0.05, 5, CAUSES) / self.size
        self.r = columns[:, -1]
        self.one_sided = np.arange(CAUSES) % 2 == 0

    @property
    def inverse(self) -> np.ndarray:
        """Covariance by the noise."""
        rows = real(self.J)
        scale = np.linalg.norm(rows, axis=0)
        return np.linalg.inv((rows / scale).T @ (rows / scale)) / np.outer(scale, scale)

    def errors(self, one_sided: np.ndarray | None = None, **more: float) -> JointErrors:
        """The joint solution."""
        signs = np.zeros(CAUSES, dtype=bool) if one_sided is None else one_sided
        return JointErrors.of(self.r, self.J, self.B, inverse=self.inverse, size=self.size, one_sided=signs, **more)

    @property
    def covariance(self) -> np.ndarray:
        """The whole covariance by the inverse of the whole information, scaled."""
        rows = np.hstack([real(self.J), real(self.B)])
        information = rows.T @ rows + np.diag(np.concatenate([np.zeros(VALUES), self.size**-2.0]))
        scale = np.sqrt(np.diag(information))
        return np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)


def real(columns: np.ndarray) -> np.ndarray:
    """Both parts one below the other."""
    return np.concatenate([columns.real, columns.imag])


@pytest.mark.parametrize("seed", range(5))
def test_shares_of_any_result_add_to_the_whole(seed: int) -> None:
    problem, rng = Linear(seed), np.random.default_rng(seed + 100)
    errors, whole = problem.errors(), problem.covariance
    for _ in range(10):
        slopes = rng.normal(size=VALUES + CAUSES) / np.sqrt(np.diag(whole))
        noise = np.sqrt(slopes[:VALUES] @ problem.inverse @ slopes[:VALUES])
        shares = errors.shares(noise, errors.along(slopes[:VALUES], slopes[VALUES:]))
        assert shares.total**2 == pytest.approx(slopes @ whole @ slopes, rel=1e-9)
        parts = noise**2 + shares.bounded**2 + np.sum(shares.trust**2)
        assert shares.total**2 == pytest.approx(parts, rel=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_the_share_on_trust_is_what_the_size_of_a_cause_brings(seed: int) -> None:
    """The estimate moves by so much for each unit that the cause truly is, of which the size is the deviation."""
    problem = Linear(seed)
    errors, step = problem.errors(), 1e-3
    for cause in range(CAUSES):
        slope = errors.along(np.zeros(VALUES), np.eye(CAUSES)[cause])
        trust = errors.shares(0.0, slope).trust
        for other in range(CAUSES):
            # readings by a cause of another true size, with its mean before the data moved to it
            moved = problem.covariance[VALUES + cause, VALUES + other] * step / problem.size[other] ** 2
            assert trust[other] * step == pytest.approx(moved * problem.size[other], rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("factor", [1.2, 7.0])
def test_larger_noise_is_the_same_as_readings_that_weigh_less(factor: float) -> None:
    problem, less = Linear(3), Linear(3)
    less.r, less.J, less.B = (part / np.sqrt(factor) for part in (less.r, less.J, less.B))
    found, unit = problem.errors().in_noise(factor), np.outer(problem.size, problem.size)
    np.testing.assert_allclose(found.covar / unit, less.errors().covar / unit, rtol=1e-8, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_a_cause_of_no_size_is_as_if_it_were_not_there(seed: int) -> None:
    problem = Linear(seed)
    left = Linear(seed)
    problem.size[2] = 1e-12 * problem.size[2]
    kept = np.arange(CAUSES) != 2
    left.B, left.size, left.one_sided = left.B[:, kept], left.size[kept], left.one_sided[kept]
    found, without = (
        problem.errors(problem.one_sided),
        JointErrors.of(left.r, left.J, left.B, inverse=left.inverse, size=left.size, one_sided=left.one_sided),
    )
    np.testing.assert_allclose(found.value[kept], without.value, rtol=1e-9, atol=1e-9 * problem.size[kept].min())
    np.testing.assert_allclose(found.covariance, without.covariance, rtol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_least_squares_of_readings_white_with_all_causes_is_the_joint_solution(seed: int) -> None:
    """Causes of both signs integrated out: the readings have the covariance ``1 + B S^2 B'``."""
    problem = Linear(seed)
    U, d, _ = np.linalg.svd(real(problem.B) * problem.size, full_matrices=False)
    white = np.eye(2 * READINGS) - U @ np.diag(1 - 1 / np.sqrt(1 + d**2)) @ U.T
    rows, residual = white @ real(problem.J), white @ real(problem.r[:, None])[:, 0]
    scale = np.linalg.norm(rows, axis=0)
    covariance = np.linalg.inv((rows / scale).T @ (rows / scale)) / np.outer(scale, scale)
    step = -covariance @ (rows.T @ residual)
    dx, sizes, _ = joint_step(
        problem.r, problem.J, problem.B, size=problem.size, one_sided=np.zeros(CAUSES, dtype=bool),
        prior=np.zeros(VALUES), prior_slope=np.zeros(VALUES),
    )  # fmt: skip
    deviation = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(dx / deviation, step / deviation, atol=1e-9)
    whole = problem.inverse + problem.errors().covariance
    unit = np.outer(deviation, deviation)
    np.testing.assert_allclose(whole / unit, covariance / unit, atol=1e-10)
    # the sizes are those of all readings at the values beside them
    at = problem.r + problem.J @ dx
    beside = np.linalg.solve(
        np.eye(CAUSES) + (real(problem.B) * problem.size).T @ (real(problem.B) * problem.size),
        -(real(problem.B) * problem.size).T @ real(at[:, None])[:, 0],
    )
    np.testing.assert_allclose(sizes / problem.size, beside, atol=1e-8)


@pytest.mark.parametrize("seed", range(12))
def test_causes_of_one_sign_are_the_best_of_every_set_held_at_zero(seed: int) -> None:
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(CAUSES, CAUSES + 1)) * 10.0 ** rng.uniform(-4, 4, (CAUSES, 1))
    covar, free = root @ root.T, rng.normal(size=CAUSES) * np.linalg.norm(root, axis=1)
    one_sided = rng.random(CAUSES) < 0.7
    found = nearest_of_one_sign(free, covar, one_sided)
    bound = np.flatnonzero(one_sided)
    best, least = free, np.inf
    for held in map(list, chain.from_iterable(combinations(bound.tolist(), k) for k in range(bound.size + 1))):
        # the most probable vector with these at zero
        there = free - covar[:, held] @ np.linalg.solve(covar[np.ix_(held, held)], free[held]) if held else free
        there[held] = 0.0
        off = np.linalg.solve(root @ root.T, there - free) @ (there - free)
        if (there[bound] >= -1e-9 * np.sqrt(np.diag(covar))[bound]).all() and off < least:
            best, least = there, off
    np.testing.assert_allclose(found / np.sqrt(np.diag(covar)), best / np.sqrt(np.diag(covar)), atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_the_step_with_signs_is_least_beside_values_that_follow(seed: int) -> None:
    """No other vector with the same signs has a smaller sum of squares."""
    problem, rng = Linear(seed), np.random.default_rng(seed)
    dx, sizes, square = joint_step(
        problem.r, problem.J, problem.B, size=problem.size, one_sided=problem.one_sided,
        prior=np.zeros(VALUES), prior_slope=np.zeros(VALUES),
    )  # fmt: skip

    def square_of(dx: np.ndarray, sizes: np.ndarray) -> float:
        left = problem.r + problem.J @ dx + problem.B @ sizes
        return float(np.vdot(left, left).real + np.sum((sizes / problem.size) ** 2))

    assert square_of(dx, sizes) == pytest.approx(square, rel=1e-9)
    assert (sizes[problem.one_sided] >= 0).all()
    scale = 1 / np.linalg.norm(problem.J, axis=0)
    for _ in range(200):
        there = sizes + 10.0 ** rng.uniform(-5, 0) * problem.size * rng.normal(size=CAUSES)
        there[problem.one_sided] = np.maximum(there[problem.one_sided], 0)
        beside = dx + 10.0 ** rng.uniform(-5, 0) * scale * rng.normal(size=VALUES)
        assert square_of(beside, there) >= square * (1 - 1e-12)


def test_the_reach_is_of_both_sides_alike_but_for_causes_of_one_sign() -> None:
    problem = Linear(1)
    problem.B *= 0.01  # all on trust
    both, one = problem.errors(), problem.errors(np.arange(CAUSES) == 3)
    slope = both.along(np.zeros(VALUES), problem.size**-1.0)
    below, above = both.reach(1.0, slope).ends(1.96)
    assert below == pytest.approx(above)
    assert below == pytest.approx(1.96 * both.shares(1.0, slope).total, rel=1e-12)
    below, above = one.reach(1.0, slope).ends(1.96)
    assert above == pytest.approx(1.96 * one.shares(1.0, slope).total, rel=0.05)
    assert below < above


def test_sizes_of_pulls_as_expected_are_left_and_pulls_twice_as_large_double_them() -> None:
    rng = np.random.default_rng(1)
    pulls = rng.normal(size=200)
    assert error_factor(pulls) == 1.0
    assert error_factor(2 * pulls) == pytest.approx(2 * np.sqrt(np.mean(pulls**2)))
    assert error_factor([]) == 1.0
