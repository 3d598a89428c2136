"""Influence of a weight on each reading: residual vector and influence from any set of weights, by least squares.

With the weight's unbalance ``u_m`` (kg m) in a force plane during mounting m, a reading at one speed is
``y_m = r + sum_planes a u_m``: r is what the rotor shows without weights (residual unbalance, bow, run-out), a the
influence of the plane. A pair at 0 and 180 degrees (eq. 20), a reference run without a weight beside a run with one,
and three weights at odd angles are all cases of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.array_types import COLLINEAR, ComplexArray, Float, Index
from rotorfit.base.significance import P_CHANCE
from rotorfit.estimators.noise.mounting import (
    MountingFit,
    coefficient_covariance,
    determines,
    repeat_variance,
    scatter,
    solve,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Readings:
    """Readings of some channels at some dwell speeds, with weights mounted again and again."""

    value: ComplexArray  # complex readings, shape ``(R,)``
    speed: Float  # rad/s, shape ``(R,)``
    mounting: Index  # number of the mounting of each, shape ``(R,)``
    channel: Index  # number of its channel, shape ``(R,)``
    dwell: Index  # number of its dwell speed, shape ``(R,)``
    unbalance: ComplexArray  # ``m r exp(j delta)`` of each mounting in each force plane, kg m, shape ``(M, planes)``
    sigma: Float  # noise that was given with the readings, NaN where it was not, shape ``(R,)``


@dataclass(frozen=True, kw_only=True, eq=False)
class PartlyKnown:
    """A cell whose weights determine some combinations of its residual and influences, and others not: a probe that one
    trial run lacks has no influence of that weight."""

    channel: int  # its channel
    dwell: int  # its dwell speed
    size: Float  # weights that residual and influences are multiplied by, to be alike, shape ``(1 + planes,)``
    coefficient: ComplexArray  # these products, the smallest that the readings allow, shape ``(1 + planes,)``
    covariance: ComplexArray  # of it, shape ``(1 + planes, 1 + planes)``, NaN where no noise is known
    projector: ComplexArray  # onto the combinations that are determined, shape ``(1 + planes, 1 + planes)``

    def combined(self, parts: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
        """Combinations of residual and influences, shape ``(K, 1 + planes)``, with their covariance; NaN where the
        readings do not determine them."""
        own = parts / self.size
        open_part = np.linalg.norm(own - own @ self.projector, axis=1)
        largest_part = 1e-6  # of a combination, over it, that nothing determines and round-off makes
        known = open_part <= largest_part * np.linalg.norm(own, axis=1)
        value = np.where(known, own @ self.coefficient, np.nan)
        covariance = own @ self.covariance @ own.conj().T
        return value, np.where(np.outer(known, known), covariance, np.nan)


@dataclass(frozen=True, kw_only=True, eq=False)
class Influence:
    """Residual vectors and influences of the cells, a cell being one channel at one dwell speed. Covariances are those
    of real and of imaginary parts, influences ordered cell by cell, plane by plane."""

    channel: Index  # number of each cell's channel, shape ``(C,)``
    dwell: Index  # number of its dwell speed, shape ``(C,)``
    speed: Float  # speed to which the readings of each dwell were brought, rad/s, shape ``(dwells,)``
    residual: ComplexArray  # readings without weights, shape ``(C,)``
    influence: ComplexArray  # per kg m, shape ``(C, planes)``
    # of the influences, without any assumption on what a mounting does to which channels, shape ``(C planes, C
    # planes)``; its rank may be too small to weigh by
    covariance: ComplexArray
    whole: ComplexArray  # the same of residuals and influences, shape ``(C (1 + planes), C (1 + planes))``
    # standard deviation that was given with the readings of each cell, NaN where it was not, shape ``(C,)``
    given: Float
    # the same where channels are independent and speeds are correlated alike in all of them; it weighs
    working: ComplexArray
    # standard deviations between mountings and between repeats in each cell, shape ``(C,)``, NaN where not known
    mounting: Float
    repeat: Float
    freedom: float  # real degrees of freedom behind the error bars, infinite where the noise was given
    weight_freedom: float  # those behind the weight of each channel in ``working``
    correlation: float  # correlation between the speeds of one channel in ``working``
    partly: tuple[PartlyKnown, ...]  # cells whose weights do not determine all influences


class UndeterminedError(ValueError):
    """The weights do not determine any influence."""


def solve_influence(readings: Readings) -> Influence:
    """Solve every cell by least squares, with the variance between mountings by restricted maximum likelihood. Readings
    of one dwell that were taken at slightly different speeds are brought to their mean speed first, along the channel's
    own change from dwell to dwell (as the square of the speed where there is one dwell only)."""
    speed = np.bincount(readings.dwell, readings.speed) / np.bincount(readings.dwell)
    value = readings.value * _to_common_speed(readings, speed)
    design = np.column_stack([np.ones(len(readings.unbalance)), readings.unbalance])
    found: list[_Cell] = []
    partly: list[PartlyKnown] = []
    for channel, dwell in sorted(set(zip(readings.channel.tolist(), readings.dwell.tolist(), strict=True))):
        rows = np.flatnonzero((readings.channel == channel) & (readings.dwell == dwell))
        mean, count = _means(value[rows], readings.mounting[rows], len(design))
        repeat, within = _repeat(readings, value, rows)
        if not determines(design[count > 0]):
            partly.append(_partly(channel, dwell, mean, count, design, repeat))
            continue
        cell = solve(mean, count, design, repeat)
        given = float(np.sqrt(np.mean(readings.sigma[rows] ** 2)))
        found.append((channel, dwell, cell, given, 2.0 * cell.freedom if cell.freedom else within))
    if not found:
        raise UndeterminedError(
            "the weights do not determine an influence: each forced plane needs a second angle, another weight, or a "
            "run without one, at the same speed"
        )
    return _assembled(found, partly, speed)


_Cell = tuple[int, int, MountingFit, float, float]
"""Channel, dwell, fit, noise that was given, and real degrees of freedom of one cell."""


def _partly(
    channel: int, dwell: int, mean: ComplexArray, count: Float, design: ComplexArray, repeat: float
) -> PartlyKnown:
    """What readings determine of a cell by too few weights: their solution along the rows of the design."""
    size = np.linalg.norm(design, axis=0)
    _, singular, rows = np.linalg.svd(design[count > 0] / size, full_matrices=False)
    along = rows[singular > COLLINEAR * singular[0]].conj().T
    cell = solve(mean, count, design / size @ along, repeat)
    spread = along @ cell.weights
    return PartlyKnown(
        channel=channel,
        dwell=dwell,
        size=size,
        coefficient=along @ cell.beta,
        covariance=cell.mean * spread @ spread.conj().T,
        projector=along @ along.conj().T,
    )


def _assembled(found: list[_Cell], partly: list[PartlyKnown], speed: Float) -> Influence:
    channels, dwells, fits, given, freedoms = zip(*found, strict=True)
    channel, dwell, cells, freedom = np.array(channels), np.array(dwells), list(fits), min(freedoms)
    size = np.sqrt([cell.mean for cell in cells])
    known = all(cell.freedom for cell in cells)
    between = scatter(cells) if known else np.diag(size**2).astype(complex)
    shared = _correlation(between, channel) if known else 0.0
    same = channel[:, None] == channel
    size = _pooled(size, channel, dwell)
    assumed = np.outer(size, size) * np.where(np.eye(len(cells)) > 0, 1.0, shared * same)
    planes = len(cells[0].beta) - 1
    kept = np.tile(np.arange(planes + 1) > 0, len(cells))
    square = np.ix_(kept, kept)
    whole = coefficient_covariance(cells, between)
    return Influence(
        channel=channel,
        dwell=dwell,
        speed=speed,
        residual=np.array([cell.beta[0] for cell in cells]),
        influence=np.array([cell.beta[1:] for cell in cells]),
        covariance=whole[square],
        whole=whole,
        given=np.array(given),
        working=coefficient_covariance(cells, assumed.astype(complex))[square],
        mounting=np.sqrt([cell.mounting for cell in cells]),
        repeat=np.sqrt([cell.repeat for cell in cells]),
        freedom=freedom,
        weight_freedom=freedom * speed.size / (1 + (speed.size - 1) * shared**2),
        correlation=shared,
        partly=tuple(partly),
    )


def _pooled(size: Float, channel: Index, dwell: Index) -> Float:
    """Standard deviations of the cells as a factor of the channel times one of the dwell. Weights from a cell's own few
    mountings would follow chance; a channel that scatters does so at every speed."""
    if not (size > 0).all():
        return size
    columns = np.hstack([channel[:, None] == np.unique(channel), dwell[:, None] == np.unique(dwell)]).astype(float)
    level = np.linalg.lstsq(columns, np.log(size**2), rcond=None)[0]
    return np.asarray(np.exp(columns @ level / 2))


def _means(value: ComplexArray, mounting: Index, size: int) -> tuple[ComplexArray, Float]:
    count = np.bincount(mounting, minlength=size).astype(float)
    total = np.bincount(mounting, value.real, size) + 1j * np.bincount(mounting, value.imag, size)
    mean = np.full(size, np.nan, dtype=complex)
    mean[count > 0] = total[count > 0] / count[count > 0]
    return mean, count


def _repeat(readings: Readings, value: ComplexArray, rows: Index) -> tuple[float, float]:
    """Variance of one repeat and its real degrees of freedom: of the cell, else of the channel, else as given."""
    for chosen in (rows, np.flatnonzero(readings.channel == readings.channel[rows[0]])):
        own = np.unique(readings.mounting[chosen] + 1j * readings.dwell[chosen], return_inverse=True)[1].reshape(-1)
        variance, freedom = repeat_variance(value[chosen], own)
        if freedom:
            return variance, 2.0 * freedom
    return float(np.mean(readings.sigma[rows] ** 2)), np.inf


def _to_common_speed(readings: Readings, speed: Float) -> ComplexArray:
    """Factor that brings each reading to the mean speed of its dwell."""
    distance = speed[readings.dwell] - readings.speed
    factor = np.ones(readings.value.size, dtype=complex)
    for channel in np.unique(readings.channel):
        mine = readings.channel == channel
        growth = _growth(readings, mine, speed)
        factor[mine] = np.exp(growth[readings.dwell[mine]] * distance[mine])
    return factor


def _growth(readings: Readings, mine: NDArray[np.bool_], speed: Float) -> ComplexArray:
    """Slope of the logarithm of a channel's readings by the speed at each dwell, from all mountings together."""
    dwells = np.unique(readings.dwell[mine])
    means = {}
    for dwell in dwells.tolist():
        rows = mine & (readings.dwell == dwell)
        means[dwell] = _means(readings.value[rows], readings.mounting[rows], len(readings.unbalance))[0]
    growth = np.asarray(2 / speed, dtype=complex)  # a weight's force, far below resonance
    order = dwells[np.argsort(speed[dwells])].tolist()
    slopes: list[complex] = []
    for low, high in pairwise(order):
        both = np.isfinite(means[low]) & np.isfinite(means[high])
        ratio = complex(np.vdot(means[low][both], means[high][both]))
        if ratio == 0:
            slopes.append(complex(growth[low]))
        else:
            ratio /= float(np.vdot(means[low][both], means[low][both]).real)
            slopes.append(complex(np.log(ratio) / (speed[high] - speed[low])))
    for place, dwell in enumerate(order):
        near = slopes[max(place - 1, 0) : place + 1]
        if near:
            growth[dwell] = sum(near) / len(near)
    return growth


def _correlation(between: ComplexArray, channel: Index) -> float:
    """Correlation between the speeds of one channel, the same for all channels."""
    size = np.sqrt(np.real(np.diag(between)))
    pairs = (channel[:, None] == channel) & ~np.eye(channel.size, dtype=bool) & (np.outer(size, size) > 0)
    if not pairs.any():
        return 0.0
    # Largest correlation between speeds that weights are built on: beyond, they follow the chance in it
    largest_correlation = 0.7
    return float(np.clip(np.mean((between.real[pairs]) / np.outer(size, size)[pairs]), 0.0, largest_correlation))


@dataclass(frozen=True, kw_only=True)
class ModesSeen:
    """Modes that influences show."""

    singular: tuple[float, ...]  # singular values of all influences, the largest that noise alone makes being one
    # natural frequencies that are determined, rad/s, ascending, with standard errors
    frequencies: tuple[tuple[float, float], ...]
    shapes: int  # number of singular values above the noise

    @property
    def count(self) -> int:
        """Modes with a shape above the noise and a natural frequency."""
        return len(self.frequencies)


def modes_seen(influence: Influence) -> ModesSeen | None:
    """How many modes influences at a few dwell speeds show: shapes by singular values against noise, poles by a pencil;
    None where one speed only, or gaps, leave nothing to compare. A mode contributes ``g phi^T w^2 / (wn^2 - w^2 + 2 j
    zeta wn w)`` to the matrix of influences. Between two speeds each mode grows by a factor of its own, an eigenvalue
    of the pencil of the two matrices, and the factor tells its natural frequency; a mode far above the speeds grows as
    w^2 and leaves its frequency open."""
    dwells = np.unique(influence.dwell).tolist()
    channels = sorted(set.intersection(*[set(influence.channel[influence.dwell == d].tolist()) for d in dwells]))
    size = influence.influence.shape[1]
    if len(dwells) < 2 or not channels or not np.isfinite(influence.covariance).all():
        return None
    place = {(int(c), int(d)): i for i, (c, d) in enumerate(zip(influence.channel, influence.dwell, strict=True))}
    cells = np.array([[place[c, d] for c in channels] for d in dwells])
    rows = (cells[:, :, None] * size + np.arange(size)).reshape(-1)
    values = influence.influence[cells]  # dwells, channels, planes
    covariance = influence.covariance[np.ix_(rows, rows)]
    sd = np.sqrt(np.real(np.diag(covariance))).reshape(values.shape)
    scale = np.maximum(sd.mean(axis=(0, 2)), 1e-30)[:, None]
    rng = np.random.default_rng(0)
    power, vectors = np.linalg.eigh(covariance)
    draws = 400  # of noise of this covariance
    raw = rng.standard_normal((draws, power.size)) + 1j * rng.standard_normal((draws, power.size))
    noise = (raw @ (vectors * np.sqrt(np.maximum(power, 0.0))).T).reshape(draws, *values.shape) / scale
    values = values / scale
    reach = np.quantile([np.linalg.svd(np.hstack(list(draw)), compute_uv=False)[0] for draw in noise], 1 - P_CHANCE)
    singular = np.linalg.svd(np.hstack(list(values)), compute_uv=False) / max(float(reach), 1e-30)
    shapes = int(np.sum(singular > 1))
    speed = influence.speed[dwells]
    order = np.argsort(speed)
    low, high = int(order[0]), int(order[-1])
    found: list[tuple[float, float]] = []
    for rank in range(min(shapes, size), 0, -1):
        between = float(speed[low]), float(speed[high]), rank
        squares = np.array([_poles(v[low], v[high], *between) for v in values + noise])
        at = _poles(values[low], values[high], *between)
        found = [pole for k in range(rank) if (pole := _determined(float(at[k]), squares[:, k])) is not None]
        if found:
            break
    return ModesSeen(singular=tuple(float(v) for v in singular), frequencies=tuple(sorted(found)), shapes=shapes)


def _poles(low: ComplexArray, high: ComplexArray, w1: float, w2: float, rank: int) -> Float:
    """Squares of the natural frequencies from influences at two speeds, largest growth first, NaN where none fits."""
    from scipy.linalg import eigvals  # late: loading it takes longer than the influences

    left = np.linalg.svd(np.hstack([low, high]))[0][:, :rank].conj().T
    right = np.linalg.svd(np.vstack([low, high]))[2][:rank].conj().T
    with np.errstate(all="ignore"):  # nothing moves at a speed whose slow roll was taken out: growth without end
        growth = eigvals(left @ high @ right, left @ low @ right)
        q = np.sort(growth.real)[::-1] * (w1 / w2) ** 2  # (wn^2 - w1^2)/(wn^2 - w2^2) without damping
        square = (q * w2**2 - w1**2) / (q - 1)
    return np.where(np.isfinite(square) & (square > 0), square, np.nan)


def _determined(square: float, draws: Float) -> tuple[float, float] | None:
    """Natural frequency and standard error, None where the draws leave it open."""
    if not np.isfinite(square) or np.mean(np.isfinite(draws)) < 1 - P_CHANCE:
        return None
    low, high = np.nanquantile(np.sqrt(draws), [0.16, 0.84])
    error, wn = float(high - low) / 2, float(np.sqrt(square))
    largest_error = 0.2  # relative standard error of a natural frequency beyond which it is not determined
    return (wn, error) if error < largest_error * wn else None
