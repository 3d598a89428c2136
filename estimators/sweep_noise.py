"""Noise of the readings of sweeps: from repeats, from the direction against the force, or from smoothness."""

from __future__ import annotations

from typing import Any

import numpy as np

from rotorfit.estimators.noise import noise_from_repeats, noise_from_samples, noise_from_smoothness
from rotorfit.estimators.observations import Responses
from rotorfit.estimators.row_keys import unique_rows
from rotorfit.models.array_types import ComplexArray, Float, Index

_SMOOTH = 0.5  # lag-one correlation above which the wrong-direction component is anisotropy, not noise


def estimate_noise(block: Responses, wrong: ComplexArray, synchronous: bool) -> Float:
    """Noise of every reading: from repeated sweeps, else from the wrong direction, else from smoothness.

    The forward and the backward sweep of one test share a noise level: probes and cables do not know which way the
    force turns, and twice the samples halve the variance of the estimate.

    Args:
        block: the readings.
        wrong: what each reading shows in the direction against the force, shape ``(R,)``, NaN without an x/y pair.
        synchronous: the frequency is the speed, so that a sweep runs over speeds.

    Returns:
        standard deviation of the real and of the imaginary part, shape ``(R,)``.

    Raises:
        ValueError: a sweep too short to show its noise.
    """
    w = block.frequency[block.line]
    speed = np.zeros_like(w) if synchronous else np.round(block.speed[block.line], 6)
    force_plane = np.argmax(np.abs(block.force[block.line]), axis=1)
    sweep = unique_rows(np.column_stack([block.label, speed, w < 0, force_plane]))[1]
    sweeps = [np.flatnonzero(sweep == k) for k in range(sweep.max() + 1)]
    sweeps = [rows[np.argsort(w[rows])] for rows in sweeps]
    sigma = np.full(w.size, np.nan)
    for row, level in _repeated(block, w, speed, force_plane).items():
        sigma[row] = level
    both: dict[tuple[Any, ...], list[Index]] = {}
    for rows in sweeps:
        if not np.isnan(sigma[rows]).any():
            continue
        drive = np.abs(block.force[block.line[rows], force_plane[rows]])
        extent = (np.abs(w[rows]).min(), np.abs(w[rows]).max(), drive.sum())
        test = (
            block.coordinate[rows[0]],
            force_plane[rows[0]],
            speed[rows[0]],
            rows.size,
            *(f"{v:.6g}" for v in extent),
        )
        both.setdefault(test, []).append(rows)
    for parts in both.values():
        rows = np.concatenate(parts)
        if np.isfinite(wrong[rows]).all() and not any(_is_smooth(wrong[part]) for part in parts):
            number = np.repeat(np.arange(len(parts)), [part.size for part in parts])
            sigma[rows] = noise_from_samples(wrong[rows], block.measured[rows], number)
        else:
            try:
                levels = [noise_from_smoothness(w[part], block.measured[part])[0] for part in parts]
            except ValueError as reason:
                raise ValueError(f"{block.labels[block.label[rows[0]]]}: {reason}") from reason
            sigma[rows] = np.sqrt(np.mean(np.square(levels)))
    return sigma


def _is_smooth(samples: ComplexArray) -> bool:
    if samples.size < 8:
        return False
    power = float(np.sum(np.abs(samples) ** 2))
    return bool(power > 0 and abs(np.sum(samples[1:] * samples[:-1].conj())) > _SMOOTH * power)


def _repeated(block: Responses, w: Float, speed: Float, force_plane: Index) -> dict[int, float]:
    """Noise of sweeps that were run again at the same force: first row of each channel to its sigma."""
    force = block.force[block.line, force_plane]
    codes = np.column_stack(
        [block.coordinate, speed, np.round(w, 9), force_plane, np.round(force.real, 12), np.round(force.imag, 12)]
    )
    _, condition = unique_rows(codes)
    sweeps: dict[tuple[int, ...], list[Index]] = {}
    for label in np.unique(block.label):
        rows = np.flatnonzero(block.label == label)
        rows = rows[np.argsort(condition[rows], kind="stable")]
        sweeps.setdefault(tuple(condition[rows].tolist()), []).append(rows)
    result: dict[int, float] = {}
    for repeated in sweeps.values():
        if len(repeated) > 1:
            sigma = noise_from_repeats(np.array([block.measured[rows] for rows in repeated]))
            floor = 1e-9 * float(np.abs(block.measured[repeated[0]]).max())
            for rows in repeated:
                result |= {int(row): max(sigma, floor) for row in rows.tolist()}
    return result
