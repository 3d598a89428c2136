"""Free vibration of a model: eigenvalues, threshold speed of instability, and their sensitivities."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rotorfit.base.array_types import ROUND_OFF, Bool, ComplexArray, Float, Index
from rotorfit.base.equality import ByValue
from rotorfit.models.model import RotorModel
from rotorfit.models.shafts.angular_rates import HIGHEST_RATE, angular_rate, angular_rates
from rotorfit.models.shafts.turning import unstable_bands

SPEEDS = 600  # speeds searched for an onset
_SENSELESS = 1e-9  # share of a mode's motion up to which a whirl of it is round-off


@dataclass(frozen=True, eq=False)
class Threshold(ByValue):
    """Onset of instability.

    Attributes:
        speed: threshold speed Omega_ST, rad/s.
        whirl_frequency: frequency of the self-excited vibration at onset, rad/s, signed in complex coordinates.
        gradient: derivative of the threshold speed with respect to the parameter vector, shape ``(P,)``.
    """

    speed: float
    whirl_frequency: float
    gradient: Float

    @property
    def whirl_ratio(self) -> float:
        """Onset whirl frequency over threshold speed, NaN for a rotor that is unstable at rest."""
        return self.whirl_frequency / self.speed if self.speed else float("nan")


def companion(coefficients: ComplexArray) -> tuple[ComplexArray, float]:
    """Companion matrix of the reversed polynomial in a scaled variable. Eigenvalues mu of the result give ``s = scale /
    mu``. Reversing puts the static stiffness, not the mass matrix, in the place that is inverted: masses may be zero,
    and a static stiffness that cannot be inverted is refused."""
    order, n = coefficients.shape[-3] - 1, coefficients.shape[-1]
    size = np.abs(coefficients).max(axis=(-1, -2)).reshape(-1, order + 1).max(axis=0)
    ratios = [(size[0] / size[k]) ** (1.0 / k) for k in range(1, order + 1) if size[k] > 0]
    scale = float(min(ratios)) if ratios else 1.0
    powers = scale ** np.arange(order + 1)
    scaled = coefficients * powers[:, None, None]
    others = np.concatenate([scaled[..., k, :, :] for k in range(1, order + 1)], axis=-1)
    try:
        top = -np.linalg.solve(scaled[..., 0, :, :], others)
    except np.linalg.LinAlgError:
        raise np.linalg.LinAlgError("a rotor without static stiffness has no modes to be judged") from None
    matrix = np.zeros((*coefficients.shape[:-3], order * n, order * n), dtype=complex)
    matrix[..., :n, :] = top
    for k in range(order - 1):
        matrix[..., (k + 1) * n : (k + 2) * n, k * n : (k + 1) * n] = np.eye(n)
    return matrix, scale


def eigenvalues(model: RotorModel, theta: ArrayLike, speed: ArrayLike) -> ComplexArray:
    """Eigenvalues s of the equation of motion, sorted by imaginary part.

    In complex coordinates a positive imaginary part is forward whirl.

    Args:
        model: the rotor.
        theta: parameter vectors, shape ``(..., P)``.
        speed: rotative speed, rad/s, broadcasting with ``theta[..., 0]``.

    Returns:
        shape ``(..., order n)``, rad/s; infinite ones (massless coordinates) are NaN and stand last.

    Raises:
        ValueError: speeds that are not finite numbers, or none.
    """
    s = spectrum(model, model.motion(theta, angular_rates(speed)))
    return np.asarray(np.take_along_axis(s, np.argsort(s.imag, axis=-1), axis=-1))


def spectrum(model: RotorModel, coefficients: ComplexArray) -> ComplexArray:
    """Eigenvalues of free motion with given coefficients, in no order."""
    if model.shaft is not None and model.shaft.has_mass:
        # Its many high modes would carry the round-off of s^2 over the lowest one.
        matrix, scale = companion(coefficients[..., ::-1, :, :])
        return np.asarray(np.linalg.eigvals(matrix) / scale)
    return roots(coefficients)


def roots(coefficients: ComplexArray) -> ComplexArray:
    """Eigenvalues of a polynomial with coefficients ``(..., order + 1, n, n)``, NaN in place of infinite ones."""
    matrix, scale = companion(coefficients)
    mu = np.linalg.eigvals(matrix)
    size = np.abs(mu)
    finite = size > 1e-9 * size.max(axis=-1, keepdims=True)
    return np.where(finite, scale / np.where(finite, mu, 1.0), complex(np.nan, np.nan))


def mode_vectors(coefficients: ComplexArray, s: ComplexArray) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """Left and right vectors of eigenvalues ``(..., n)``, and the product of both with d kappa / d s ``(...)``."""
    order = np.arange(coefficients.shape[-3])
    powers = s[..., None] ** order
    left, _, right = np.linalg.svd(np.einsum("...k,...kij->...ij", powers, coefficients))
    u, v = left[..., -1].conj(), right[..., -1, :].conj()
    slope = np.einsum("...k,...kij->...ij", order[1:] * powers[..., :-1], coefficients[..., 1:, :, :])
    return u, v, np.asarray(np.einsum("...i,...ij,...j->...", u, slope, v))


def seats(model: RotorModel) -> Index:
    """Places of the model's coordinates among those of free motion."""
    return np.arange(len(model.coordinates)) if model.shaft is None else model.shaft.at


def is_image(model: RotorModel, theta: ArrayLike, speed: float, s: complex) -> bool:
    """True if an eigenvalue is no mode of its own: in x and y one of a conjugate pair, in turning coordinates that of
    another line, such as the image, of a motion. Where motion and image grow together, between the edges of an unstable
    band, neither is."""
    if not model.turns:
        return model.frame == "xy" and s.imag < 0
    _, shape, _ = mode_vectors(model.motion(theta, speed), np.asarray(s))
    lines = np.linalg.norm(shape.reshape(model.line_count, -1), axis=1)
    return bool(lines[0] < (1 - 1e-6) * lines[1:].max())


def whirl_sense(model: RotorModel, theta: ArrayLike, speed: float, s: ComplexArray) -> Index:
    """1 for modes ``(modes,)`` that whirl with the rotation, -1 for those against it, 0 for those without a sense: that
    do not oscillate, move along a line, or that no speed tells from their image. In x and y a mode and its conjugate
    have one orbit; its sense, from x to y or back, says it."""
    swings = np.abs(s.imag) > _SENSELESS * np.abs(s)
    if model.frame == "z":
        told = model.speed_dependent or model.at_one_speed
        return np.where(swings & told, np.sign(s.imag), 0.0).astype(np.intp)
    _, shape, _ = mode_vectors(np.asarray(model.motion(theta, speed)), s)
    half = shape.shape[-1] // 2
    x, y = shape[:, :half], shape[:, half:]
    ahead, back = (np.sum(np.abs(x + turn * y) ** 2, axis=1) for turn in (1j, -1j))
    turns = np.abs(ahead - back) > _SENSELESS * (ahead + back)
    return np.where(swings & turns, np.sign((ahead - back) * s.imag), 0.0).astype(np.intp)


def growth_rate(model: RotorModel, theta: ArrayLike, speed: ArrayLike, band: float = math.inf) -> Float:
    """Largest real part of the eigenvalues with ``|s| <= band``, 1/s; positive means unstable."""
    return fastest_growth(model, model.motion(theta, speed), band)


def growing(model: RotorModel, theta: Float, speed: Float, band: float) -> tuple[Float, Bool]:
    """Largest growth rate of rotors at speeds, 1/s, and whether it is more than round-off, shape ``(K,)``.

    Args:
        model: the rotor.
        theta: parameter vectors, shape ``(K, P)``.
        speed: rotative speed of each, rad/s, shape ``(K,)``.
        band: eigenvalues up to this size count, rad/s.
    """
    if len(speed) == 1:  # one by numbers: arrays of one entry cost several times as much
        rates = growth_rate(model, theta[0], speed[0], band)[None]
    else:
        rates = growth_rate(model, theta, speed, band)
    return rates, np.asarray(rates > 1e-9 * np.abs(theta).max(axis=1))


def fastest_growth(model: RotorModel, coefficients: ComplexArray, band: float = math.inf) -> Float:
    """Largest real part of the eigenvalues, as :func:`growth_rate`, with the coefficients of free motion at hand."""
    return np.asarray(_growth(spectrum(model, coefficients), band).max(axis=-1))


def _growth(s: ComplexArray, band: float) -> Float:
    """Real parts of eigenvalues, minus infinity of those that do not count."""
    return np.where(np.isfinite(s) & (np.abs(s) <= band), s.real, -np.inf)


def stability_band(model: RotorModel, tested: float) -> float:
    """Frequencies that count for stability: all, but only the tested band with corrections above s^2 or delays."""
    return tested if model.order > 2 or model.in_band_only else math.inf


def counted(model: RotorModel, s: ComplexArray, band: float) -> Bool:
    """Eigenvalues that count: up to a band, of a whole shaft as many as its planes can follow."""
    size = np.where(np.isfinite(s), np.abs(s), np.inf)
    limit = np.asarray(band)
    if model.shaft is not None:
        lowest = np.sort(size, axis=-1)[..., min(model.order * len(model.coordinates), s.shape[-1]) - 1]
        limit = np.minimum(lowest, band)[..., None]
    return np.asarray((size <= limit) & np.isfinite(size))


def decay_rate(model: RotorModel, theta: ArrayLike, speed: ArrayLike, band: float) -> Float:
    """Rate at which the slowest free motion that counts dies out, 1/s; negative where it grows."""
    s = spectrum(model, model.motion(theta, speed))
    return np.asarray(np.where(counted(model, s, band), -s.real, np.inf).min(axis=-1))


def eigenvalue_gradient(
    model: RotorModel, theta: ArrayLike, speed: ArrayLike, s: ArrayLike, coefficients: ComplexArray | None = None
) -> tuple[ComplexArray, ComplexArray]:
    """Derivatives of simple eigenvalues by the speed, shape ``(...)``, and by the parameters, shape ``(..., P)``; the
    coefficients of free motion are worked out where they are not at hand."""
    coefficients, s = model.motion(theta, speed) if coefficients is None else coefficients, np.asarray(s)
    u, v, by_s = mode_vectors(coefficients, s)
    jacobian = model.motion_jacobian(theta, speed)
    entries = s[..., None] ** jacobian.powers * u[..., jacobian.rows] * v[..., jacobian.columns] * jacobian.values
    total = np.zeros((*entries.shape[:-1], len(model.parameters) + 2), dtype=complex)
    np.add.at(total.T, jacobian.inputs, entries.T)
    total /= -by_s[..., None]
    return total[..., -2], total[..., :-2]


def least_stable(
    model: RotorModel, theta: ArrayLike, speed: ArrayLike, *, band: float = math.inf
) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
    """The least stable eigenvalue of many rotors, NaN where none counts, and its slopes by speed and parameters."""
    coefficients = model.motion(theta, speed)
    s = spectrum(model, coefficients)
    growth = _growth(s, band)
    rows, place = np.arange(len(s)), growth.argmax(axis=-1)
    counted = np.isfinite(growth[rows, place])
    least = s[rows, place]
    by_speed, by_theta = eigenvalue_gradient(model, theta, speed, np.where(counted, least, 1j), coefficients)
    return np.where(counted, least, np.nan), by_speed, by_theta


def growing_bands(model: RotorModel, theta: ArrayLike, max_speed: float) -> list[tuple[float, float]]:
    """Ranges of speed, rad/s, in which free motion of any model grows; some narrower than a step are passed over."""
    from scipy.optimize import brentq

    max_speed = angular_rate(max_speed, "max_speed", positive=True)
    values = np.asarray(theta, dtype=float)

    def rate(speed: float) -> float:
        return float(growth_rate(model, values, speed))

    speeds = np.linspace(max_speed / SPEEDS, max_speed, SPEEDS)
    grows = np.concatenate([growth_rate(model, values, part) > 0 for part in np.array_split(speeds, 10)])
    edges = [
        float(brentq(rate, speeds[i], speeds[i + 1], xtol=1e-12 * max_speed))
        for i in np.flatnonzero(grows[1:] != grows[:-1]).tolist()
    ]
    edges = [*([0.0] if grows[0] else []), *edges, *([max_speed] if grows[-1] else [])]
    return list(zip(edges[::2], edges[1::2], strict=True))


def threshold_speed(
    model: RotorModel, theta: ArrayLike, *, band: float = math.inf, max_speed: float | None = None
) -> Threshold | None:
    """Lowest rotative speed at which the rotor loses stability (section "Stability"; eq. 18 in general).

    Args:
        model: the rotor.
        theta: parameter vector, shape ``(P,)``.
        band: count only eigenvalues with ``|s|`` up to this, rad/s. Needed with the ``out_of_band`` block, whose
            polynomial has spurious roots beyond the tested band.
        max_speed: highest speed searched, rad/s; by default 30 times the highest finite natural frequency in band.

    Returns:
        the threshold, or ``None`` if no eigenvalue within the band becomes unstable up to ``max_speed``. With a finite
        band that does not say that the rotor is stable: its onset may lie beyond.

    Raises:
        ValueError: no positive speed to search up to, or no positive band.
    """
    if max_speed is not None:
        max_speed = angular_rate(max_speed, "max_speed", positive=True)
    if not (isinstance(band, int | float) and band > 0):
        raise ValueError(f"band is {band!r}; it must be a positive frequency in rad/s, or infinite")
    theta = np.asarray(theta, dtype=float)
    if not model.speed_dependent:
        return None
    highest, round_off = search_limits(model, theta, band)
    max_speed = highest if max_speed is None else max_speed
    speeds = np.geomspace(max_speed * 1e-4, max_speed, SPEEDS)
    if model.turns:  # bands of instability narrower than the steps of the search
        middles = [(low + high) / 2 for low, high in unstable_bands(model, theta, max_speed)]
        speeds = np.sort(np.concatenate([speeds, middles]))

    onset = first_growth(lambda speed: growth_rate(model, theta, speed, band) - round_off, speeds)
    return None if onset is None else _threshold_at(model, theta, onset, band)


def first_growth(rate: Callable[[Float], Float], speeds: Float) -> float | None:
    """Lowest speed, rad/s, from which motion grows, zero before those searched; None if it does at none of them."""
    from scipy.optimize import brentq  # loads much of SciPy

    at_once = 60  # a scan mostly ends in the first part
    for start in range(0, speeds.size, at_once):
        grows = rate(speeds[start : start + at_once]) > 0
        if not grows.any():
            continue
        first = start + int(np.argmax(grows))
        low, high = (float(speeds[first - 1]) if first else 0.0), float(speeds[first])

        def at(speed: float) -> float:
            return float(rate(np.array([speed]))[0])

        return low if at(low) >= 0 else float(brentq(at, low, high, xtol=1e-12 * high, rtol=1e-13))
    return None


def _threshold_at(model: RotorModel, theta: Float, onset: float, band: float) -> Threshold | None:
    """The onset and its mode once its speed is found; ``None`` if no eigenvalue became unstable there."""
    s = eigenvalues(model, theta, onset)
    s = s[np.isfinite(s) & (np.abs(s) <= band)]
    critical = complex(s[np.argmax(s.real)])
    turned = onset if model.turns else 0.0
    growth = 1e-6  # growth over frequency at an onset beyond which an eigenvalue did not become unstable there
    if onset > 0 and critical.real > growth * abs(critical + 1j * turned):
        return None  # it entered the band already unstable, so its onset lies beyond
    by_speed, by_theta = eigenvalue_gradient(model, theta, onset, critical) if onset > 0 else (1.0, theta * np.nan)
    # With x and y apart the eigenvalues are pairs of either sign: which of them was met first says nothing.
    whirl = critical.imag if model.frame == "z" else abs(critical.imag)
    whirl += turned
    return Threshold(onset, whirl, np.asarray(-by_theta.real / complex(by_speed).real))


def search_limits(model: RotorModel, theta: Float, band: float) -> tuple[float, float]:
    """Highest speed worth a search, and the real part up to which an eigenvalue counts as undamped."""
    rest = np.abs(eigenvalues(model, theta, 0.0))
    rest = np.sort(rest[np.isfinite(rest) & (rest <= band) & (rest > 0)])
    # The many modes of a known structure above those that the coordinates can follow only add round-off.
    round_off = ROUND_OFF * float(rest[-1]) if rest.size and model.shaft is not None else 0.0
    rest = rest[: model.order * len(model.coordinates)]
    return min(30.0 * float(rest[-1]), HIGHEST_RATE) if rest.size else 1e4, round_off


def threshold_speeds(model: RotorModel, theta: ArrayLike, *, band: float = math.inf) -> tuple[Float, Float]:
    """Threshold speeds and whirl frequencies of many rotors alike, rad/s, infinite and NaN of stable ones. Searched on
    a grid around the median rotor's: what closes between two speeds may be passed over."""
    theta = np.asarray(theta, dtype=float)
    onset, whirl = np.full(theta.shape[0], np.inf), np.full(theta.shape[0], np.nan)
    if not model.speed_dependent:
        return onset, whirl
    middle = np.median(theta, axis=0)
    top, round_off = search_limits(model, middle, band)
    low, high = np.zeros_like(onset), np.full_like(onset, np.nan)
    searching = np.arange(onset.size)
    for speed in _search_speeds(theta - middle, threshold_speed(model, middle, band=band), top):
        unstable = growth_rate(model, theta[searching], speed[searching], band) > round_off
        high[searching[unstable]] = speed[searching[unstable]]
        searching = searching[~unstable]
        low[searching] = speed[searching]
        if not searching.size:
            break
    lowest = np.flatnonzero(np.isfinite(high) & (low == 0.0))
    if lowest.size:
        high[lowest[growth_rate(model, theta[lowest], 0.0, band) >= round_off]] = 0.0  # unstable at rest
    found = np.flatnonzero(np.isfinite(high))
    onset[found], whirl[found] = _crossings(model, theta[found], low[found], high[found], band, round_off)
    if model.turns:
        whirl[found] += onset[found]
    return onset, whirl


def _crossings(
    model: RotorModel, theta: Float, low: Float, high: Float, band: float, round_off: float
) -> tuple[Float, Float]:
    """Speeds between ``low`` and ``high`` at which motion of each rotor begins to grow, and the frequencies there, by
    Newton's method; by halves where a step of it leads out of the bounds."""
    speed, whirl = (low + high) / 2, np.full_like(low, np.nan)
    open_ = np.arange(low.size)
    while open_.size:
        at = speed[open_]
        s, by_speed, _ = least_stable(model, theta[open_], at, band=band)
        grows = s.real > round_off
        low[open_[~grows]], high[open_[grows]] = at[~grows], at[grows]
        half = (low[open_] + high[open_]) / 2 - at
        with np.errstate(divide="ignore", invalid="ignore"):  # a mode that does not change with speed has no step
            step = (round_off - s.real) / by_speed.real
        inside = (low[open_] <= at + step) & (at + step <= high[open_])
        step = np.where(inside, step, half)
        speed[open_], whirl[open_] = at + step, (s + by_speed * step).imag
        # Newton's error is the square of its last step.
        open_ = open_[np.abs(step) > np.where(inside, 1e-6, 1e-13) * high[open_]]
    return speed, whirl


def _search_speeds(away: Float, reference: Threshold | None, top: float) -> list[Float]:
    """Ascending speeds of rotors that lie ``away`` from one, each ``(N,)``: dense around its threshold, moved along."""
    if reference is None or reference.speed <= 0:
        return [np.full(len(away), speed) for speed in np.geomspace(top * 1e-4, top, 60)]
    near = np.clip(reference.speed + away @ reference.gradient, reference.speed / 2, 2 * reference.speed)
    beyond = np.geomspace(4.5 * reference.speed, max(top, 5 * reference.speed), 8)
    factors = (0.1, 0.5, 0.97, 1.03, 1.1, 1.25, 1.6, 2.2)
    return [*(near * factor for factor in factors), *(np.full(len(away), speed) for speed in beyond)]
