"""Spectra of forces that nobody measured, and of the floor of the readings: shapes, and the numbers that fit best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from rotorfit.base.array_types import RANK_TOLERANCE, Bool, ComplexArray, Float

KNOTS = 6
"""Frequencies, evenly spread in their logarithm, between which the force's spectrum is a straight line. Chosen."""


@dataclass(frozen=True)
class ForceShape:
    """How the spectra of force and floor may depend on frequency, beside a level of each plane."""

    slope: str = "white"  # white, power (one exponent), planes (one of each plane), knots
    turning: bool = False  # whether force forward and backward differ by a factor
    floor: bool = False  # whether the floor has an exponent: where it shows too little for one, errors are not known

    def __str__(self) -> str:
        turned = ", forward and backward apart" if self.turning else ""
        return f"{self.slope}{turned}{', floor not white' if self.floor else ''}"

    @property
    def neighbours(self) -> tuple[ForceShape, ...]:
        """Shapes that differ in frequency, of force and floor, or in the senses of turning."""
        return tuple(
            one
            for one in SHAPES
            if (one.turning == self.turning) ^ (one == replace(self, turning=one.turning))  # not in both, not in none
        )


SHAPES = tuple(
    ForceShape(slope, turning, floor)
    for floor in (False, True)
    for turning in (False, True)
    for slope in ("white", "power", "planes", "knots")
)
"""All shapes, in the order in which they are tried: those that the data are most likely to tell first."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Spectrum:
    """A spectral matrix ``E L L^* E`` of n signals: ln E linear in the numbers, L unit lower triangular."""

    basis: Float  # of ln E by the first numbers, shape ``(lines, n, k)``
    below: tuple[tuple[int, int], ...]  # places of L whose real and imaginary parts are the numbers that follow
    mirrored: Bool  # lines at -w, of which the conjugate is meant, shape ``(lines,)``

    @property
    def size(self) -> int:
        """Count of the numbers."""
        return int(self.basis.shape[-1]) + 2 * len(self.below)

    def values(self, numbers: Float) -> tuple[ComplexArray, ComplexArray]:
        """The matrices ``(lines, n, n)`` and their derivatives ``(size, lines, n, n)``."""
        k, n = self.basis.shape[-1], self.basis.shape[1]
        level = np.exp(self.basis @ numbers[:k])
        lower = np.eye(n, dtype=complex)
        for number, (i, j) in enumerate(self.below):
            lower[i, j] = complex(numbers[k + 2 * number], numbers[k + 2 * number + 1])
        scale = level[:, :, None] * level[:, None, :]
        whole = scale * (lower @ lower.conj().T)
        slopes = np.empty((self.size, *whole.shape), dtype=complex)
        along = np.moveaxis(self.basis, -1, 0)
        slopes[:k] = (along[:, :, :, None] + along[:, :, None, :]) * whole
        for number, (i, j) in enumerate(self.below):
            for part, unit in enumerate((1.0, 1j)):
                change = np.zeros((n, n), dtype=complex)
                change[i] = unit * lower[:, j].conj()
                slopes[k + 2 * number + part] = scale * (change + change.conj().T)
        back = self.mirrored[:, None, None]
        return np.where(back, whole.conj(), whole), np.where(back, slopes.conj(), slopes)


def spectra_of(shape: ForceShape, frequency: Float, forced: int, read: int) -> tuple[Spectrum, Spectrum]:
    """Spectra of the force at so many planes and of the floor of so many readings, at cells forward, then backward."""
    w = np.tile(frequency, 2)
    back = np.repeat([False, True], frequency.size)
    low, high = w.min(), w.max()
    middle = np.log(w) - np.log(np.sqrt(low * high))
    levels = np.broadcast_to(np.eye(forced), (w.size, forced, forced))
    parts = [levels]
    if shape.slope == "power":
        parts.append(np.broadcast_to(-middle[:, None, None] / 2, (w.size, forced, 1)))
    elif shape.slope == "planes":
        parts.append(-middle[:, None, None] / 2 * levels)
    elif shape.slope == "knots":
        knots = np.linspace(np.log(low), np.log(high), KNOTS)
        roofs = np.array([np.interp(np.log(w), knots, one) for one in np.eye(KNOTS)[1:]])
        parts.append(np.broadcast_to(roofs.T[:, None, :], (w.size, forced, KNOTS - 1)))
    if shape.turning:
        sense = np.where(back, -0.25, 0.25)
        parts.append(np.broadcast_to(sense[:, None, None], (w.size, forced, 1)))
    own = np.broadcast_to(np.eye(read), (w.size, read, read))
    # the floor's level is that at the top of the band, where it shows: its exponent then moves little else
    slope = np.broadcast_to(-(np.log(w) - np.log(high))[:, None, None] / 2, (w.size, read, 1))
    floors = np.concatenate([own, slope], axis=-1) if shape.floor else own
    # forces that no probe tells apart are taken for independent
    tied = tuple((i, j) for i in range(forced) for j in range(i)) if read >= forced else ()
    floor = tuple((i, j) for i in range(read) for j in range(i))
    return (
        Spectrum(basis=np.concatenate(parts, axis=-1), below=tied, mirrored=back),
        Spectrum(basis=floors, below=floor, mirrored=back),
    )


def first_numbers(measured: ComplexArray, read: ComplexArray, force: Spectrum, floor: Spectrum) -> tuple[Float, Float]:
    """Levels of force and floor to begin with: white, by medians of powers and by the quietest frequencies. Beside them
    lower bounds: nothing shows of what is less, and a search that went on would not come back."""
    n = read.shape[1]
    power = np.einsum("lii->li", measured).real
    gain = np.sum(np.abs(read) ** 2, axis=(1, 2))
    numbers = np.zeros(force.size + floor.size)
    levels, floors = slice(read.shape[2]), slice(force.size, force.size + n)
    numbers[levels] = 0.5 * np.log(np.median(power.sum(axis=1) / gain))
    quiet = 0.1  # share of the lines that show little else than the floor
    numbers[floors] = 0.5 * np.log(np.quantile(power, quiet, axis=0) / 2)
    lower = np.full(numbers.size, -np.inf)
    least = np.log(1e3), np.log(30.0)  # below the first: power over 1e6, of the floor, which shows, over 1e3
    lower[levels], lower[floors] = numbers[levels] - least[0], numbers[floors] - least[1]
    return numbers, lower


def most_likely(
    spectra: Callable[[Float], tuple[ComplexArray, ComplexArray, ComplexArray]],
    starts: Sequence[Float],
    lower: Float,
    measured: ComplexArray,
    nu: Float,
) -> tuple[Float, Bool] | None:
    """Numbers of greatest likelihood, from lower bounds on, by Fisher scoring from the better of some starts, and which
    of them rest on no bound; None where no start gives any likelihood."""
    m = measured.shape[-1]
    scale = np.sqrt(nu)[:, None, None]

    def at(some: Float) -> tuple[float, Float, Float]:
        S, slopes, _ = spectra(some)
        weight = inverse_root(S)
        rows = _parts(scale * (weight @ slopes @ adjoint(weight)))
        inside = weight @ measured @ adjoint(weight)
        size = np.linalg.slogdet(inside)[1]
        cost = float(nu @ (np.einsum("lii->l", inside).real - m - size))
        return cost, rows @ _parts(scale * (np.eye(m) - inside)), rows @ rows.T

    damping, enough = 0.0, 1e9
    roughly, closely, settled = 1e-8, 1e-12, 1e-22  # promised gains over the cost: far from the data few digits will do
    with np.errstate(all="ignore"):
        there = [(at(start), start) for start in (np.maximum(start, lower) for start in starts)]
        (cost, slope, matrix), numbers = min(there, key=lambda pair: np.nan_to_num(pair[0][0], nan=np.inf))
        if not _finite(cost, slope, matrix):
            return None
        before = np.inf
        for _ in range(100):
            free = (numbers > lower) | (slope < 0)
            downhill = np.where(free, slope, 0.0)
            diagonal = np.maximum(np.diag(matrix), 1e-9 * np.diag(matrix).max())
            added = (damping + RANK_TOLERANCE) * diagonal + ~free
            inside = np.where(free[:, None] & free, matrix, 0.0) + np.diag(added)
            step = -np.linalg.solve(inside, downhill)
            gain, unit = -float(downhill @ step), max(cost, 1.0)
            far = cost > 2 * measured.size
            close = not damping and gain < closely * unit  # the cost has no more digits, the slope has
            if gain < (roughly if far else settled) * unit or damping > enough or (close and gain >= before):
                break
            before = gain if close else np.inf
            step /= max(1.0, float(np.abs(step).max()) / 3.0)  # as a whole: parts of it may lead up
            trial = np.maximum(numbers + step, lower)
            step = trial - numbers
            new = at(trial)
            down, up = -float(slope @ step), float(new[1] @ step)
            if up > down / 4:  # too far, where the data curve the likelihood more than they are expected to
                trial = numbers + step * (down / (down + up))
                new = at(trial)
            if _finite(*new) and (close or new[0] <= cost):
                numbers, (cost, slope, matrix) = trial, new
                damping = damping / 10 if damping > 1e-6 else 0.0
            else:
                damping = max(10 * damping, 1e-4)
    return numbers, (numbers > lower) | (slope < 0)


def _finite(cost: float, slope: Float, matrix: Float) -> bool:
    return bool(np.isfinite(cost + slope.sum() + matrix.sum()))


def following(by_theta: ComplexArray, by_numbers: ComplexArray, free: Bool, weight: ComplexArray, nu: Float) -> Float:
    """What numbers of force and floor, fitted again, fall by a unit of each parameter, shape ``(K, P)``; ``free``:
    those that rest on no bound."""
    scale = np.sqrt(nu)[:, None, None]
    by_numbers = by_numbers * free[:, None, None, None]
    own, theirs = (_parts(scale * (weight @ some @ adjoint(weight))) for some in (by_theta, by_numbers))
    size = np.linalg.norm(theirs, axis=1)
    size = np.where(size > 0, size, 1.0)
    unit = theirs / size[:, None]
    inverse_of_unit = np.linalg.pinv(unit @ unit.T, rcond=RANK_TOLERANCE, hermitian=True)
    return np.asarray(inverse_of_unit @ (unit @ own.T) / size[:, None])


def inverse_root(matrix: ComplexArray) -> ComplexArray:
    """Inverse of Cholesky's lower factor of matrices ``(..., m, m)``; NaN where there is none."""
    if matrix.shape[-1] == 1:
        return np.asarray(1 / np.sqrt(matrix.real) + 0j)
    try:
        return np.asarray(np.linalg.inv(np.linalg.cholesky(matrix)))
    except np.linalg.LinAlgError:
        return np.full(matrix.shape, complex(np.nan))


def adjoint(matrix: ComplexArray) -> ComplexArray:
    """Conjugate transposes of matrices ``(..., n, m)``."""
    return np.conj(np.swapaxes(matrix, -1, -2))


def _parts(matrix: ComplexArray) -> Float:
    """Both parts of all entries of matrices ``(..., L, m, m)``, ``(..., 2 L m m)``: products of Hermitian ones are
    traces."""
    return np.ascontiguousarray(matrix).view(float).reshape(*matrix.shape[:-3], -1)
