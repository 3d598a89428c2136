"""Frequency and damping of the modes in a record of free vibration, with their errors.

The matrix pencil (Hua & Sarkar 1990) gives the exponentials without iteration; least squares on the record, linear in
the amplitudes, refines them. The number of exponentials is chosen by BIC. Noise that a filter has passed follows itself
from sample to sample: errors count the correlation of what the sum leaves. Steady vibration at known frequencies, as of
unbalance, is linear in its amplitudes too: it joins the sum, and is taken out before the pencil, which would call it a
mode.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float

_EXTRA = 2  # vibrating modes looked for beyond those asked for
_PENCIL = 120  # longest window of the pencil: longer ones cost more and gain nothing
_SHORTEST = 0.05  # ratio of successive samples of a decay that is seen at all
_GROWTH = 1e6  # growth over the record beyond which an exponential is no motion of a rotor
_APART = 0.1  # relative shift in frequency of the two modes that are looked for in the place of one
_HARDLY = 0.05  # of a frequency: distance from it, decay included, at which a mode may be steady vibration
_ROWS = 1500  # windows of the pencil
_CHANCE = 2.0  # standard deviations of a correlation of white noise
_ROUNDS = 4  # in which correlations and what the sum takes up of the noise settle
_LEAST = 0.01  # of the variance in white noise, to which a filter may bring that of an eigenvalue down


@dataclass(frozen=True, eq=False, kw_only=True)
class Decay:
    """A sum of decaying vibrations about a constant.

    Attributes:
        s: eigenvalues with positive imaginary part, shape ``(m,)``, and real ones.
        real: real eigenvalues.
        centre: where x and y settle.
        energy: share of each mode in the record.
        sigma: standard deviation of each mode's eigenvalue.
        bic: for the choice of the order.
        steady: frequencies of the undamped vibration in the sum, rad/s.
    """

    s: ComplexArray
    real: Float
    centre: complex
    energy: Float
    sigma: Float
    bic: float
    steady: Float


def decay_of(time: Float, signals: Float, modes: int, steady: Float | None = None) -> Decay | None:
    """The sum of decaying vibrations that a record holds, of the order that BIC prefers.

    Args:
        time: equal steps from zero, s, shape ``(n,)``.
        signals: x and y, shape ``(2, n)``.
        modes: vibrating modes that the sum has at least.
        steady: frequencies of vibration that does not decay, rad/s, such as those of the shaft's turning.

    Returns:
        the sum, None where no sum of so many modes is found.
    """
    found = list(_decays(time, signals, modes, np.zeros(0)))
    if steady is not None and any(_is_steady(decay, steady) for decay in found):
        found += _decays(time, signals, modes, steady)
    # Forward and backward whirl of a nearly centred rotor lie so close that the pencil, in noise, sees one mode.
    doubled = [(d.s[:, None] + 1j * d.s.imag[:, None] * np.array([-_APART, _APART])).ravel() for d in found]
    found += [
        _refine(time, signals, s, d.real, d.steady)
        for d, s in zip(found, doubled, strict=True)
        if 0 < s.size <= 2 * modes
    ]
    candidates = [decay for decay in found if decay.s.size >= modes]
    return min(candidates, key=lambda decay: decay.bic) if candidates else None


def _is_steady(decay: Decay, steady: Float) -> bool:
    """Whether a sum has steady vibration among its modes."""
    return bool((np.abs(decay.s[:, None] - 1j * steady) < _HARDLY * steady).any())


def _decays(time: Float, signals: Float, modes: int, steady: Float) -> Iterator[Decay]:
    """Fits of several orders; poles of the pencil decide how many of them vibrate."""
    step = float(time[-1] / (time.size - 1))
    top = min(2 * (modes + _EXTRA) + 1, time.size // 4)
    waves = _basis(time, np.zeros(0, dtype=complex), np.zeros(0), steady)[:, :-1]
    moving = signals - (waves @ np.linalg.lstsq(waves, signals.T, rcond=None)[0]).T if steady.size else signals
    for count in range(2 * modes, top + 1):
        ratio = _pencil(moving, count)
        size = np.abs(ratio) ** (time.size - 1)
        if (np.abs(ratio) < _SHORTEST).any() or (size > _GROWTH).any():
            continue  # more exponentials than the record holds: the rest of them are noise
        s = np.log(ratio) / step
        vibrating = np.asarray(s[s.imag > 1e-9 / step], dtype=complex)
        real = np.asarray(s[np.abs(s.imag) <= 1e-9 / step].real, dtype=float)
        if vibrating.size >= modes and 2 * vibrating.size + real.size == count:
            # The real exponential nearest to a constant is the constant. A centred journal has none, or noise for it.
            real = np.delete(real, np.argmin(np.abs(real))) if real.size else real
            yield _refine(time, signals, vibrating, real, steady)


def _pencil(signals: Float, count: int) -> ComplexArray:
    """Ratios of successive samples of the ``count`` strongest exponentials that x and y share."""
    n = signals.shape[1]
    width = min(n // 3, _PENCIL)
    stride = max(1, (n - width) // _ROWS)
    windows = np.lib.stride_tricks.sliding_window_view(signals, width + 1, axis=1)[:, ::stride].reshape(-1, width + 1)
    _, _, right = np.linalg.svd(windows, full_matrices=False)
    V = right[:count].T
    return np.asarray(np.linalg.eigvals(np.linalg.lstsq(V[:-1], V[1:], rcond=None)[0]).astype(complex))


def _basis(time: Float, s: ComplexArray, real: Float, steady: Float) -> Float:
    """Columns of the sum: cosine and sine of each mode, the real decays, the steady vibration, the constant."""
    largest = 2 * np.log(_GROWTH) / time[-1]  # keeps trial points of the search finite
    wave = np.exp(np.outer(time, np.minimum(s.real, largest) + 1j * s.imag))
    decays, turning = np.exp(np.outer(time, np.minimum(real, largest))), np.outer(time, steady)
    return np.column_stack([wave.real, wave.imag, decays, np.cos(turning), np.sin(turning), np.ones(time.size)])


def _refine(time: Float, signals: Float, s: ComplexArray, real: Float, steady: Float) -> Decay:
    """Least squares in the eigenvalues, the amplitudes projected out (Kaufman 1975)."""
    from scipy.optimize import least_squares

    m, scale = s.size, float(np.abs(np.concatenate([s, real])).max())
    level = float(np.sqrt(np.mean(signals**2)))

    def parts(u: Float) -> tuple[ComplexArray, Float]:
        s = np.asarray((u[:m] + 1j * u[m : 2 * m]) * scale, dtype=complex)
        return s, np.asarray(u[2 * m :] * scale)

    def project(u: Float) -> tuple[Float, Float, Float]:
        basis = _basis(time, *parts(u), steady)
        q, r = np.linalg.qr(basis)
        inner = q.T @ signals.T
        amplitudes = np.linalg.lstsq(r, inner, rcond=None)[0]
        return q, amplitudes, (signals.T - q @ inner) / level

    def residual(u: Float) -> Float:
        return np.asarray(project(u)[2].T.ravel())

    def slopes(u: Float) -> Float:
        q, amplitudes, _ = project(u)
        basis = _basis(time, *parts(u), steady)
        last = 2 * m + real.size
        cosine, sine, decay = basis[:, :m], basis[:, m : 2 * m], basis[:, 2 * m : last]
        columns = []
        for axis in range(2):
            a, b, d = amplitudes[:m, axis], amplitudes[m : 2 * m, axis], amplitudes[2 * m : last, axis]
            by = np.column_stack([a * cosine + b * sine, -a * sine + b * cosine, d * decay]) * time[:, None] * scale
            columns.append(-(by - q @ (q.T @ by)) / level)
        return np.concatenate(columns)

    start = np.concatenate([s.real, s.imag, real]) / scale
    found = least_squares(residual, start, jac=slopes, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
    s, real = parts(found.x)
    _, amplitudes, rest = project(found.x)
    count = found.x.size + amplitudes.size
    variance = float(np.sum(rest**2)) / max(rest.size - count, 1)
    _, size, directions = np.linalg.svd(found.jac, full_matrices=False)
    # What the record does not determine must weigh nothing: no pseudo-inverse, which would call it exact.
    least = np.finfo(float).eps * size[0]
    root = directions.T / np.maximum(size, least)
    gain = found.jac @ root @ root.T  # of the noise into the eigenvalues
    linear = np.kron(np.eye(2), np.linalg.qr(_basis(time, s, real, steady))[0])
    own = np.column_stack([np.linalg.qr(found.jac)[0], linear])  # what the sum takes up of the noise
    power, lags = _noise(rest, own.reshape(2, time.size, -1))
    spread = _scatter(gain.reshape(2, time.size, -1), lags) * power * scale**2
    energy = np.sum((_basis(time, s, np.zeros(0), np.zeros(0))[:, : 2 * m] ** 2).mean(axis=0).reshape(2, m), axis=0)
    energy = energy * np.sum(amplitudes[: 2 * m].reshape(2, m, 2) ** 2, axis=(0, 2))
    step = float(time[-1] / (time.size - 1))
    sigma = np.sqrt((spread[:m] + spread[m : 2 * m]) / 2)
    good = (s.imag > 0) & (s.imag < np.pi / step) & np.isfinite(energy)
    resolved = bool((sigma < np.abs(s)).all())  # a sum that the record does not determine is no candidate
    floor = 1e-12 * np.abs(s)  # a record without noise would weigh infinitely
    bic = rest.size * float(np.log(max(variance, 1e-30))) + count * float(np.log(rest.size))
    return Decay(
        s=s[good],
        real=real,
        centre=complex(*amplitudes[-1]),
        energy=energy[good],
        sigma=np.maximum(sigma, floor)[good],
        bic=bic if resolved else np.inf,
        steady=steady,
    )


def _noise(rest: Float, own: Float) -> tuple[float, Float]:
    """Variance of the noise and its correlations at distances 0, 1, ... up to the first that chance explains.

    What is left of noise lacks what the sum took up, which is the more the longer its memory: repeated a few times.

    Args:
        rest: what the sum leaves, shape ``(n, 2)``.
        own: orthonormal columns that span what the sum takes up, signal by signal, shape ``(2, n, p)``.
    """
    lags, variance = np.ones(1), 0.0
    for _ in range(_ROUNDS):
        follows = own + sum(v * (_later(own, k) + _earlier(own, k)) for k, v in enumerate(lags[1:].tolist(), start=1))
        other = follows - own @ np.einsum("atp,atq->pq", own, follows) / 2
        taken = 2 * float(np.sum(own * other))
        variance = float(np.sum(rest**2)) / max(rest.size - taken, 1.0)
        found = [1.0]
        for lag in range(1, len(rest) // 4):
            taken = float(np.sum(own[:, lag:] * other[:, :-lag]) + np.sum(other[:, lag:] * own[:, :-lag]))
            value = (float(np.sum(rest[lag:] * rest[:-lag])) / max(variance, 1e-300) + taken) / rest.size
            if value < _CHANCE / np.sqrt(rest.size):
                break
            found.append(value)
        lags = np.array(found)
    return variance, lags


def _later(columns: Float, lag: int) -> Float:
    return np.concatenate([np.zeros_like(columns[:, :lag]), columns[:, :-lag]], axis=1)


def _earlier(columns: Float, lag: int) -> Float:
    return np.concatenate([columns[:, lag:], np.zeros_like(columns[:, :lag])], axis=1)


def _scatter(gain: Float, lags: Float) -> Float:
    """Variance of ``gain.T @ noise``, entry by entry, for noise of unit variance with given correlations along time.

    Args:
        gain: shape ``(2, n, p)``, signal by signal.
        lags: correlations at distances 0, 1, ...
    """
    white = np.sum(gain**2, axis=(0, 1))
    total = white
    for lag, value in enumerate(lags[1:].tolist(), start=1):
        total = total + 2 * value * np.sum(gain[:, lag:] * gain[:, :-lag], axis=(0, 1))
    # Correlations that are cut off need not be those of any noise.
    return np.asarray(np.maximum(total, _LEAST * white))
