"""Spectra of forces that nobody measured, and of the floor of the readings: shapes, and the numbers that fit best."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rotorfit.base.array_types import RANK_TOLERANCE, Bool, ComplexArray, Float

_COMMON = 5.0
"""Largest part of what signals have in common over what is each one's own: a coherence of 0.96."""
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


SHAPES = tuple(
    ForceShape(slope, turning, floor)
    for floor in (False, True)
    for turning in (True, False)
    for slope in ("knots", "planes", "power", "white")
)
"""All shapes, in the order in which they are tried: with the freest force first, as it finds the rotor from afar."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Spectrum:
    """A spectral matrix ``E L L^* E`` of n signals: E^2 their spectra, ln E linear in the numbers; L lower triangular
    with rows of length 1, so that what signals have in common changes no spectrum of one of them."""

    basis: Float  # of ln E by the first numbers, shape ``(lines, n, k)``
    below: tuple[tuple[int, int], ...]  # places of L over its diagonal, real and imaginary, are the numbers that follow
    mirrored: Bool  # lines at -w, of which the conjugate is meant, shape ``(lines,)``

    @property
    def size(self) -> int:
        """Count of the numbers."""
        return int(self.basis.shape[-1]) + 2 * len(self.below)

    def root(self, numbers: Float) -> ComplexArray:
        """``E L`` of every line, ``(lines, n, n)``."""
        lower = self._lower(numbers)
        lower /= np.linalg.norm(lower, axis=1, keepdims=True)
        back = self.mirrored[:, None, None]
        return np.asarray(self._levels(numbers)[:, :, None] * np.where(back, lower.conj(), lower))

    def slopes(self, numbers: Float, seen: ComplexArray) -> ComplexArray:
        """Derivatives by the numbers of the matrix as it is seen through others ``(lines, m, n)``, of every line,
        ``(lines, size, m, m)``."""
        k = self.basis.shape[-1]
        root = self.root(numbers)
        shown = adjoint(seen @ root)
        along = np.swapaxes(seen, 1, 2)[..., None] * (root @ shown)[:, :, None, :]
        parts = along.reshape(*along.shape[:2], -1).view(float)  # of one signal's level each
        levels = (np.swapaxes(self.basis, 1, 2) @ parts).view(complex).reshape(len(seen), k, *along.shape[2:])
        scaled = self._levels(numbers)[:, None] * seen
        beside = [
            scaled[:, :, i, None] * (np.where(self.mirrored[:, None], row.conj(), row)[:, None] @ shown)
            for i, row in self._turns(numbers)
        ]
        whole = np.concatenate([levels, *(one[:, None] for one in beside)], axis=1)
        return np.asarray(whole + adjoint(whole))

    def _levels(self, numbers: Float) -> Float:
        return np.asarray(np.exp(self.basis @ numbers[: self.basis.shape[-1]]))

    def _lower(self, numbers: Float) -> ComplexArray:
        """L before its rows are of length 1."""
        lower, k = np.eye(self.basis.shape[1], dtype=complex), self.basis.shape[-1]
        for number, (i, j) in enumerate(self.below):
            lower[i, j] = complex(numbers[k + 2 * number], numbers[k + 2 * number + 1])
        return lower

    def _turns(self, numbers: Float) -> Iterator[tuple[int, ComplexArray]]:
        """Row of L that each number below the diagonal changes, and its derivative."""
        lower = self._lower(numbers)
        for i, j in self.below:
            size = np.linalg.norm(lower[i])
            for unit, part in ((1.0, lower[i, j].real), (1j, lower[i, j].imag)):
                change = -lower[i] * part / size**3
                change[j] += unit / size
                yield i, change


def spectra_of(
    shape: ForceShape, frequency: Float, forced: int, read: int, *, apart: bool = False
) -> tuple[Spectrum, Spectrum]:
    """Spectra of the force at so many planes and of the floor of so many readings, at cells forward, then backward;
    ``apart``: with nothing in common."""
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
    tied = tuple((i, j) for i in range(forced) for j in range(i)) if read >= forced and not apart else ()
    floor = tuple((i, j) for i in range(read) for j in range(i)) if not apart else ()
    return (
        Spectrum(basis=np.concatenate(parts, axis=-1), below=tied, mirrored=back),
        Spectrum(basis=floors, below=floor, mirrored=back),
    )


def first_numbers(
    measured: ComplexArray, read: ComplexArray, force: Spectrum, floor: Spectrum
) -> tuple[Float, tuple[Float, Float]]:
    """Levels of force and floor to begin with: white, by medians of powers and by the quietest frequencies. Beside them
    bounds: nothing shows of what is less, or more nearly the same, and a search that went on would not come back."""
    n = read.shape[1]
    power = np.einsum("lii->li", measured).real
    gain = np.sum(np.abs(read) ** 2, axis=(1, 2))
    numbers = np.zeros(force.size + floor.size)
    levels, floors = slice(read.shape[2]), slice(force.size, force.size + n)
    numbers[levels] = 0.5 * np.log(np.median(power.sum(axis=1) / gain))
    quiet = 0.1  # share of the lines that show little else than the floor
    numbers[floors] = 0.5 * np.log(np.quantile(power, quiet, axis=0) / 2)
    lower, upper = np.full(numbers.size, -np.inf), np.full(numbers.size, np.inf)
    least = np.log(1e3), np.log(30.0)  # below the first: power over 1e6, of the floor, which shows, over 1e3
    lower[levels], lower[floors] = numbers[levels] - least[0], numbers[floors] - least[1]
    for whole, begin in ((force, 0), (floor, force.size)):
        own = slice(begin + whole.basis.shape[-1], begin + whole.size)
        lower[own], upper[own] = -_COMMON, _COMMON
    return numbers, (lower, upper)


def most_likely(
    spectra: Callable[[Float], ComplexArray],
    slopes: Callable[[Float, ComplexArray], ComplexArray],
    starts: Sequence[Float],
    bounds: tuple[Float, Float],
    measured: ComplexArray,
    nu: Float,
) -> tuple[Float, Bool] | None:
    """Numbers of greatest likelihood, within bounds, by scoring from the better of some starts, and which of
    them rest on no bound; None where no start gives any likelihood.

    ``slopes``: derivatives of the spectra, between a weight and its adjoint. The matrix of a step is the mean of that
    which is expected and, of levels, of what the data give: far from them the one alone leads much too far.
    """
    m, (lower, upper) = measured.shape[-1], bounds
    sizes = np.linalg.slogdet(measured)[1]

    def at(some: Float) -> tuple[float, Float, Float]:
        weight = inverse_root(spectra(some))
        inside = weight @ measured @ adjoint(weight)
        size = sizes + 2 * np.log(np.einsum("lii->li", weight).real).sum(axis=1)
        cost = float(nu @ (np.einsum("lii->l", inside).real - m - size))
        rows = slopes(some, weight)
        own, scaled = _parts(rows), nu[:, None, None]
        weighed = _parts(rows @ (scaled * (np.eye(m) + inside) / 2)[:, None])
        return cost, own @ _parts((scaled * (np.eye(m) - inside))[:, None])[0], weighed @ own.T

    damping, enough = 0.0, 1e9
    roughly, closely, settled = 1e-8, 1e-12, 1e-22  # promised gains over the cost: far from the data few digits will do
    with np.errstate(all="ignore"):
        there = [(at(start), start) for start in (np.clip(start, lower, upper) for start in starts)]
        (cost, slope, matrix), numbers = min(there, key=lambda pair: np.nan_to_num(pair[0][0], nan=np.inf))
        if not _finite(cost, slope, matrix):
            return None
        before = np.inf
        for number in range(100):
            free = _free(numbers, slope, bounds)
            downhill = np.where(free, slope, 0.0)
            diagonal = np.maximum(np.diag(matrix), 1e-9 * np.diag(matrix).max())
            added = (damping + RANK_TOLERANCE) * diagonal + ~free
            inside = np.where(free[:, None] & free, matrix, 0.0) + np.diag(added)
            step = -np.linalg.solve(inside, downhill)
            gain, unit = -float(downhill @ step), max(cost, 1.0)
            step = np.clip(numbers + step, lower, upper) - numbers
            far = cost > 2 * measured.size
            long = far and number > 20  # where nothing fits, the best is no use
            close = not damping and gain < closely * unit  # the cost has no more digits, the slope has
            if gain < (roughly if far else settled) * unit or damping > enough or long or (close and gain >= before):
                break
            before = gain if close else np.inf
            step /= max(1.0, float(np.abs(step).max()) / 3.0)  # as a whole: parts of it may lead up
            trial = numbers + step
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
    return numbers, _free(numbers, slope, bounds)


def _free(numbers: Float, slope: Float, bounds: tuple[Float, Float]) -> Bool:
    return np.asarray(((numbers > bounds[0]) | (slope < 0)) & ((numbers < bounds[1]) | (slope > 0)))


def _finite(cost: float, slope: Float, matrix: Float) -> bool:
    return bool(np.isfinite(cost + slope.sum() + matrix.sum()))


def following(by_theta: ComplexArray, by_numbers: ComplexArray, free: Bool, nu: Float) -> Float:
    """What numbers of force and floor, fitted again, fall by a unit of each parameter, shape ``(K, P)``; ``free``:
    those that rest on no bound. Both derivatives, ``(L, ..., m, m)``, of spectra of unit size."""
    scale = np.sqrt(nu)[:, None, None, None]
    own, theirs = _parts(scale * by_theta), _parts(scale * by_numbers) * free[:, None]
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
    """Both parts of all entries of matrices ``(L, K, m, m)``, ``(K, 2 L m m)``: products of Hermitian ones are
    traces."""
    whole = np.ascontiguousarray(np.swapaxes(matrix, 0, 1))
    return whole.view(float).reshape(whole.shape[0], -1)
