"""Free vibration: frequency and damping of its modes in a record, and a mode that a ramp of speed leaves ringing.

The matrix pencil (Hua & Sarkar 1990) gives the exponentials without iteration; least squares on the record, linear in
the amplitudes, refines them. The number of exponentials is chosen by BIC. Noise that a filter has passed follows itself
from sample to sample: errors count the correlation of what the sum leaves. Steady vibration at known frequencies, as of
unbalance, is linear in its amplitudes too: it joins the sum, and is taken out before the pencil, which would call it a
mode.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import ROUND_OFF, ComplexArray, Float
from rotorfit.base.significance import CHANCE_ERRORS

LARGEST_GROWTH = 1e6
"""Growth over the record beyond which an exponential is no motion of a rotor. Chosen."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Decay:
    """A sum of decaying vibrations about a constant."""

    s: ComplexArray  # eigenvalues with positive imaginary part, shape ``(m,)``, and real ones
    real: Float  # real eigenvalues
    centre: complex  # where x and y settle
    energy: Float  # share of each mode in the record
    sigma: Float  # standard deviation of each mode's eigenvalue
    bic: float  # for the choice of the order, infinite where the record does not determine the sum
    steady: Float  # frequencies of the undamped vibration in the sum, rad/s


def decay_of(time: Float, signals: Float, modes: int, steady: Float | None = None) -> Decay | None:
    """The sum of decaying vibrations whose order BIC prefers; None where the record shows none of so many modes."""
    found = list(_decays(time, signals, modes, np.zeros(0)))
    steady_distance = 0.05  # of a frequency: distance from it, decay included, at which a mode may be steady vibration
    if steady is not None:  # one of the modes may be steady vibration
        apart = [np.abs(decay.s[:, None] - 1j * steady) for decay in found]
        if any((distance < steady_distance * steady).any() for distance in apart):
            found += _decays(time, signals, modes, steady)
    # Forward and backward whirl of a nearly centred rotor lie so close that the pencil, in noise, sees one mode.
    shift = 0.1  # relative shift in frequency of the two modes that are looked for in the place of one
    doubled = [(d.s[:, None] + 1j * d.s.imag[:, None] * np.array([-shift, shift])).ravel() for d in found]
    found += [
        _refine(time, signals, s, d.real, d.steady)
        for d, s in zip(found, doubled, strict=True)
        if 0 < s.size <= 2 * modes
    ]
    candidates = [decay for decay in found if decay.s.size >= modes and np.isfinite(decay.bic)]
    return min(candidates, key=lambda decay: decay.bic) if candidates else None


def _decays(time: Float, signals: Float, modes: int, steady: Float) -> Iterator[Decay]:
    """Fits of several orders; poles of the pencil decide how many of them vibrate."""
    step = float(time[-1] / (time.size - 1))
    extra = 2  # vibrating modes looked for beyond those asked for
    top = min(2 * (modes + extra) + 1, time.size // 4)
    waves = columns_of_sum(time, np.zeros(0, dtype=complex), np.zeros(0), steady)[:, :-1]
    moving = signals - (waves @ np.linalg.lstsq(waves, signals.T, rcond=None)[0]).T if steady.size else signals
    # Directions of windows of the signals by their strength, strongest first, one a row.
    longest, most_windows = 120, 1500  # windows of the pencil: longer ones, and more, cost more and gain nothing
    width = min(time.size // 3, longest)
    stride = max(1, (time.size - width) // most_windows)
    windows = np.lib.stride_tricks.sliding_window_view(moving, width + 1, axis=1)[:, ::stride].reshape(-1, width + 1)
    _, strength, directions = np.linalg.svd(windows, full_matrices=False)
    top = min(
        top, int(np.sum(strength > ROUND_OFF * strength[0]))
    )  # weaker ones are round-off of a record without noise
    least_decay_ratio = 0.05  # ratio of successive samples of a decay that is seen at all
    for count in range(2 * modes, top + 1):
        # Ratios of successive samples of as many exponentials as directions, the strongest that x and y share.
        V = directions[:count].T
        ratio = np.linalg.eigvals(np.linalg.lstsq(V[:-1], V[1:], rcond=None)[0]).astype(complex)
        size = np.abs(ratio) ** (time.size - 1)
        if (np.abs(ratio) < least_decay_ratio).any() or (size > LARGEST_GROWTH).any():
            continue  # more exponentials than the record holds: the rest of them are noise
        s = np.log(ratio) / step
        vibrating = np.asarray(s[s.imag > 1e-9 / step], dtype=complex)
        real = np.asarray(s[np.abs(s.imag) <= 1e-9 / step].real, dtype=float)
        if vibrating.size >= modes and 2 * vibrating.size + real.size == count:
            # The real exponential nearest to a constant is the constant. A centred journal has none, or noise for it.
            real = np.delete(real, np.argmin(np.abs(real))) if real.size else real
            yield _refine(time, signals, vibrating, real, steady)


def _refine(time: Float, signals: Float, s: ComplexArray, real: Float, steady: Float) -> Decay:
    """Least squares in the eigenvalues, with their errors."""
    from scipy.optimize import least_squares

    total = DecayingSum(time, signals, s, real, steady)
    m = s.size
    tolerance = 1e-12  # relative change of the squares, 1e-4 standard errors in a record of some thousand samples
    found = least_squares(
        total.residual, total.start, jac=total.slopes, method="lm", xtol=tolerance, ftol=tolerance, gtol=tolerance
    )
    s, real = total.eigenvalues(found.x)
    at = total.project(found.x)
    rest = at.rest / total.level
    spread = _variances(rest, found.jac, at.q) * total.scale**2
    energy = total.energy(found.x)
    step = float(time[-1] / (time.size - 1))
    sigma = np.sqrt((spread[:m] + spread[m : 2 * m]) / 2)
    good = (s.imag > 0) & (s.imag < np.pi / step) & np.isfinite(energy)
    resolved = bool((sigma < np.abs(s)).all())  # a sum that the record does not determine is no candidate
    floor = 1e-12 * np.abs(s)  # a record without noise would weigh infinitely
    count = found.x.size + at.amplitudes.size
    variance = float(np.sum(rest**2)) / max(rest.size - count, 1)
    bic = rest.size * float(np.log(max(variance, 1e-30))) + count * float(np.log(rest.size))
    return Decay(
        s=s[good],
        real=real,
        centre=complex(*at.amplitudes[-1]),
        energy=energy[good],
        sigma=np.maximum(sigma, floor)[good],
        bic=bic if resolved else np.inf,
        steady=steady,
    )


def _variances(rest: Float, jacobian: Float, q: Float) -> Float:
    """Variances of the eigenvalues' vector by what the sum leaves of the record, its correlation in time counted."""
    _, size, directions = np.linalg.svd(jacobian, full_matrices=False)
    # What the record does not determine must weigh nothing: no pseudo-inverse, which would call it exact.
    least = np.finfo(float).eps * size[0]
    root = directions.T / np.maximum(size, least)
    gain = jacobian @ root @ root.T  # of the noise into the eigenvalues
    own = np.column_stack([np.linalg.qr(jacobian)[0], np.kron(np.eye(2), q)])  # what the sum takes up of the noise
    power, lags = _noise(rest, own.reshape(2, len(rest), -1))
    gain = gain.reshape(2, len(rest), -1)
    white = np.sum(gain**2, axis=(0, 1))
    total = white
    for lag, value in enumerate(lags[1:].tolist(), start=1):
        total = total + 2 * value * np.sum(gain[:, lag:] * gain[:, :-lag], axis=(0, 1))
    # Correlations that are cut off need not be those of any noise.
    floor = 0.01  # of the variance in white noise, to which a filter may bring that of an eigenvalue down
    return np.asarray(np.maximum(total, floor * white) * power)


def _noise(rest: Float, own: Float) -> tuple[float, Float]:
    """Variance of the noise and its correlations at distances 0, 1, ... up to the first that chance explains. What is
    left of noise lacks what the sum took up, which is the more the longer its memory: repeated a few times."""
    lags, variance = np.ones(1), 0.0
    for _ in range(4):  # in which correlations and what the sum takes up of the noise settle
        follows = own.copy()
        for lag, value in enumerate(lags[1:].tolist(), start=1):
            follows[:, lag:] += value * own[:, :-lag]
            follows[:, :-lag] += value * own[:, lag:]
        other = follows - own @ np.einsum("atp,atq->pq", own, follows) / 2
        taken = 2 * float(np.sum(own * other))
        variance = float(np.sum(rest**2)) / max(rest.size - taken, 1.0)
        found = [1.0]
        for lag in range(1, len(rest) // 4):
            taken = float(np.sum(own[:, lag:] * other[:, :-lag]) + np.sum(other[:, lag:] * own[:, :-lag]))
            value = (float(np.sum(rest[lag:] * rest[:-lag])) / max(variance, 1e-300) + taken) / rest.size
            if value < CHANCE_ERRORS / np.sqrt(rest.size):
                break
            found.append(value)
        lags = np.array(found)
    return variance, lags


def columns_of_sum(time: Float, s: ComplexArray, real: Float, steady: Float) -> Float:
    """Columns of the sum: cosine and sine of each mode, the real decays, the steady vibration, the constant."""
    largest = 2 * np.log(LARGEST_GROWTH) / time[-1]  # keeps trial points of the search finite
    wave = np.exp(np.outer(time, np.minimum(s.real, largest) + 1j * s.imag))
    decays, turning = np.exp(np.outer(time, np.minimum(real, largest))), np.outer(time, steady)
    return np.column_stack([wave.real, wave.imag, decays, np.cos(turning), np.sin(turning), np.ones(time.size)])


@dataclass(frozen=True, eq=False, kw_only=True)
class Projected:
    """The best sum with given eigenvalues."""

    basis: Float  # its columns, shape ``(n, p)``, see :func:`columns_of_sum`
    q: Float  # an orthonormal basis of the same, same shape
    amplitudes: Float  # of the columns in x and y, shape ``(p, 2)``
    rest: Float  # what the sum leaves of x and y, shape ``(n, 2)``


class DecayingSum:
    """Residuals of a record and their derivatives by the eigenvalues of a sum of decaying vibrations, its amplitudes
    projected out (Kaufman 1975). Eigenvalues are one vector ``u``: real and imaginary parts of the vibrating ones, then
    the real ones, over a scale."""

    def __init__(self, time: Float, signals: Float, s: ComplexArray, real: Float, steady: Float) -> None:
        self.time, self.signals, self.steady = time, signals, steady
        self.modes = s.size
        self.scale = float(np.abs(np.concatenate([s, real])).max())
        self.level = float(np.sqrt(np.mean(signals**2)))
        self.start = np.concatenate([s.real, s.imag, real]) / self.scale
        self._last: tuple[Float, Projected] | None = None

    def eigenvalues(self, u: Float) -> tuple[ComplexArray, Float]:
        """The vibrating and the real eigenvalues, 1/s."""
        m = self.modes
        return np.asarray((u[:m] + 1j * u[m : 2 * m]) * self.scale, dtype=complex), np.asarray(u[2 * m :] * self.scale)

    def project(self, u: Float) -> Projected:
        """The best sum; a search asks for residuals and derivatives at the same points, so the last is kept."""
        if self._last is None or not np.array_equal(u, self._last[0]):
            basis = columns_of_sum(self.time, *self.eigenvalues(u), self.steady)
            q, r = np.linalg.qr(basis)
            inner = q.T @ self.signals.T
            amplitudes = np.linalg.lstsq(r, inner, rcond=None)[0]
            found = Projected(basis=basis, q=q, amplitudes=amplitudes, rest=self.signals.T - q @ inner)
            self._last = u.copy(), found
        return self._last[1]

    def residual(self, u: Float) -> Float:
        """Residuals of the best sum, of x, then of y, over the level of the record, shape ``(2 n,)``."""
        return np.asarray(self.project(u).rest.T.ravel() / self.level)

    def slopes(self, u: Float) -> Float:
        """Derivatives of the residuals, the change of the amplitudes left out where that is allowed."""
        at, m = self.project(u), self.modes
        cosine, sine, decay = at.basis[:, :m], at.basis[:, m : 2 * m], at.basis[:, 2 * m : u.size]
        columns = []
        for axis in range(2):
            a, b, d = at.amplitudes[:m, axis], at.amplitudes[m : 2 * m, axis], at.amplitudes[2 * m : u.size, axis]
            by = np.column_stack([a * cosine + b * sine, -a * sine + b * cosine, d * decay])
            by *= self.time[:, None] * self.scale
            columns.append(-(by - at.q @ (at.q.T @ by)) / self.level)
        return np.concatenate(columns)

    def energy(self, u: Float) -> Float:
        """Mean square of each vibrating mode in the record, shape ``(m,)``."""
        at, m = self.project(u), self.modes
        power = (at.basis[:, : 2 * m] ** 2).mean(axis=0).reshape(2, m).sum(axis=0)
        return np.asarray(power * np.sum(at.amplitudes[: 2 * m].reshape(2, m, 2) ** 2, axis=(0, 2)))


@dataclass(frozen=True, kw_only=True)
class Ramp:
    """One mode under a ramp of speed."""

    rate: float  # change of the speed, rad/s^2
    rate_error: float  # its standard error, rad/s^2
    wn: float  # natural frequency, rad/s
    wn_error: float  # its standard error, rad/s
    steady_wn: float  # natural frequency that a quasi-steady fit up to the beating gives, rad/s
    beats_from: float  # speed from which the amplitude beats, rad/s


def ramp_response(speed: Float, wn: float, zeta: float, rate: float) -> ComplexArray:
    """Response of a mode to a unit unbalance per modal mass, relative to ``exp(j theta)``, shape of ``speed``. With
    ``theta = rate t^2 / 2`` the unbalance's force is ``-U d^2 exp(j theta)/dt^2``. The response to ``exp(j theta)`` is
    a convolution of exponentials with a chirp, a scaled complementary error function of complex argument; what a
    quasi-steady fit takes for the resonance comes late, at too high a speed on the way up."""
    from scipy.special import wofz  # takes long to import, and few tests are run-ups

    s = wn * (-zeta + np.array([1j, -1j]) * np.sqrt(1 - zeta**2))
    root = np.sqrt(-0.5j * rate)
    parts = [0.5 * np.sqrt(np.pi) / root * wofz(0.5j * (1j * speed - pole) / root) for pole in s]
    y = (parts[0] - parts[1]) / (s[0] - s[1])
    slope = (s[0] * parts[0] - s[1] * parts[1]) / (s[0] - s[1])
    return np.asarray(2 * zeta * wn * slope + wn**2 * y - 1.0)


def steady_response(speed: Float, wn: float, zeta: float) -> ComplexArray:
    """The same where the speed does not change: ``Omega^2/(wn^2 - Omega^2 + 2 j zeta wn Omega)``."""
    return np.asarray(speed**2 / (wn**2 - speed**2 + 2j * zeta * wn * speed))


def find_beat(speed: Float, response: ComplexArray) -> tuple[float, float, float] | None:
    """True if the amplitude beats beyond its peak as a ramp makes it. Minima of the beat follow each other at even
    steps of the square of the distance from the resonance, ``4 pi rate`` apart. Returns the speed of the peak, speed of
    the first minimum beyond it, and the ramp's rate, rad/s^2; None without a beat."""
    from scipy.signal import find_peaks  # loads much of SciPy, and few tests are run-ups

    size = np.abs(response)
    peak = int(np.argmax(size))
    least_rise = 0.04  # rise on both sides of a minimum, as a fraction of the peak, that makes it one
    least = peak + find_peaks(-size[peak:], prominence=least_rise * float(size[peak]))[0]
    if least.size < 3:
        return None
    most_beats = 5  # minima looked at: later ones drown in noise
    least = least[:most_beats]
    square = (speed[least] - speed[peak]) ** 2
    steps = np.diff(square)
    typical = float(np.median(steps))
    largest_unevenness = 0.25  # relative deviation from even steps in (Omega - peak)^2 that still is a beat; chosen
    if (steps <= 0).any() or np.abs(steps - typical).max() > 2 * largest_unevenness * typical:
        return None
    return float(speed[peak]), float(speed[least[0]]), typical / (4 * np.pi)


def fit_ramp(speed: Float, response: ComplexArray) -> Ramp | None:
    """Natural frequency from a run-up that rings on, the ramp fitted with it; None where nothing beats. Beside mode and
    ramp a constant vector is fitted: run-out, and other modes."""
    order = np.argsort(speed)
    w, y = speed[order], response[order] / np.abs(response).max()
    fewest = 20  # samples that the fit of seven numbers needs at least
    beat = find_beat(w, y) if w.size >= fewest else None
    if beat is None:
        return None
    peak, first, rate = beat
    near = w < 2 * first - peak + 0.5 * (first - peak)
    early = w < first
    steady = _solve(w[early], y[early], np.array([peak, 0.03]), steady_response)
    factor_range = 4.0  # ramps tried about that of the beat, each way, as a factor
    tries = [
        _solve(w[near], y[near], np.array([peak - 0.02 * k * peak, 0.02, rate * factor]), ramp_response)
        for k in (0, 1, 2)
        for factor in np.geomspace(1 / factor_range, factor_range, 3)
    ]
    best = min(tries, key=lambda found: found[2])
    values, errors, _ = best
    return Ramp(
        rate=float(values[2]),
        rate_error=float(errors[2]),
        wn=float(values[0]),
        wn_error=float(errors[0]),
        steady_wn=float(steady[0][0]),
        beats_from=first,
    )


def _solve(w: Float, y: ComplexArray, start: Float, shape: Callable[..., ComplexArray]) -> tuple[Float, Float, float]:
    """Nonlinear numbers with standard errors, and the squares that remain."""

    from scipy.optimize import least_squares  # takes long to import, and few tests are run-ups

    def miss(u: Float) -> Float:
        basis = np.column_stack([shape(w, *(u * start).tolist()), np.ones(w.size)])
        left = y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]
        return np.asarray(left).view(float)

    low, high = np.full(start.size, 0.1), np.full(start.size, 10.0)
    low[0], high[0] = 0.8, 1.2
    found = least_squares(
        miss, np.ones(start.size), bounds=(low, high), x_scale=np.r_[0.01, np.full(start.size - 1, 0.3)]
    )
    left = float(np.sum(found.fun**2))
    freedom = max(2 * w.size - start.size - 4, 1)
    covariance = np.linalg.pinv(found.jac.T @ found.jac) * left / freedom
    return found.x * start, np.sqrt(np.diag(covariance)) * start, left
