"""Frequency responses of a swept test by local models of the spectrum: no sweep bias, and errors that are known.

The spectra of a whole record obey ``Z(w) = sum_j H_j(w) F_j(w) + T(w) + sum_i c_i U_i(w) + noise``: H_j the frequency
responses to the forces F_j, T the transient (what the rotor did before the record began and will do after it), all of
them smooth, and U_i the spectra of what is locked to the shaft (run-out, residual unbalance). In a band of lines H and
T are polynomials and the c_i constants; linear least squares gives them, and the noise level from what is left (local
polynomial method, R. Pintelon and J. Schoukens, System Identification, 2nd ed., 2012, ch. 7). How fast the frequency
was swept is nowhere in it. Several records share their H and have a transient and constants each: that is how start-ups
with the weight at opposite places are differenced.

Two choices of ours:

- Bands do not slide but tile the axis (:func:`tile`), and H is reported at the zeros of the polynomial of degree R + 1
  that is orthogonal with the weight ``|F|^2`` on the lines of the band (Gauss nodes). By the Christoffel-Darboux
  identity the R + 1 estimates of a band are uncorrelated there, so that a fit may take them for independent; they hold
  all that the band knows; and the leading term that the polynomial leaves out vanishes there.
- The noise level of a band is pooled with its neighbours' unless it is clearly above them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from rotorfit.base.array_types import ROUND_OFF, Bool, ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.base.significance import SIGNIFICANT_ERRORS

SMOOTH_DEGREE = 2
"""Degree of the polynomials that a response and a transient are in a band: its numerator, where it has a pole there."""

POOLED_FREEDOM = 60
"""Complex degrees of freedom that a noise level is pooled from, so that it is known to 1/(2 sqrt(60)) = 6 %."""

INPUT_AMPLITUDE_SHARE = 3e-3
"""An input counts in a band where what is not smooth of its spectrum exceeds this fraction of its greatest line."""

POLE_PASSES = 4
"""Times that poles are looked for in a record without transients, whose bands are narrow: those of rough responses, and
those of responses with the poles found before."""

POLE_HALF_WIDTHS, LEAST_POLE_DISTANCE = 12.0, 0.2
"""A pole counts in a band when it is nearer to its middle than so many half-widths, and further from the axis."""


@dataclass(frozen=True, kw_only=True, eq=False)
class RecordSpectra:
    """Spectra of one whole record on equally spaced lines."""

    frequency: Float  # of the lines, rad/s, shape ``(K,)``, ascending
    outputs: ComplexArray  # shape ``(P, K)``
    forces: ComplexArray  # shape ``(J, K)``
    others: ComplexArray  # inputs to which the response is constant within a band, shape ``(M, K)``
    force_noise: float = 0.0  # ``E |N|^2`` of the noise of each line of the forces where they were measured


@dataclass(frozen=True, kw_only=True, eq=False)
class LocalResponse:
    """Frequency responses at the nodes of the bands."""

    frequency: Float  # of each node, rad/s, shape ``(L,)``, ascending
    response: ComplexArray  # H, output over force, shape ``(J, P, L)``
    sigma: Float  # standard deviation of its real part and of its imaginary part, shape ``(J, P, L)``
    noise: Float  # noise of the spectrum of each output around the node, ``sqrt(E |N|^2)``, shape ``(P, L)``
    width: Float  # width of the band around each node, rad/s, shape ``(L,)``
    residual: tuple[ComplexArray, ...]  # what is left of the spectra on the lines of each record, shape ``(P, K)`` each
    covariance: ComplexArray = field(default_factory=lambda: np.zeros((0, 0, 0), dtype=complex))
    """Of H to two forces, over the variance of the noise, shape ``(J, J, L)``; empty where nothing asks for it."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LocalFit:
    """Least squares in one band of N lines, those of all records one after the other."""

    node: Float  # frequencies of the nodes, rad/s, shape ``(L,)``
    response: ComplexArray  # H there, shape ``(J, P, L)``
    covariance: ComplexArray  # of H to the forces, over the variance of the noise of the spectrum, shape ``(J, J, L)``
    residual: ComplexArray  # shape ``(P, N)``
    unknowns: int  # number of complex unknowns for each output
    lines: tuple[slice, ...]  # where the band is in each record

    @property
    def leverage(self) -> Float:
        """Variance of H over that of the noise of the spectrum, shape ``(J, L)``."""
        return np.asarray(np.einsum("jjl->jl", self.covariance).real)

    @property
    def dof(self) -> int:
        """Complex degrees of freedom left for the noise, for each output."""
        return int(self.residual.shape[1]) - self.unknowns

    @property
    def misfit(self) -> Float:
        """Sum of squares of the residual of each output."""
        return np.asarray(np.sum(np.abs(self.residual) ** 2, axis=1))


def local_response(
    records: Sequence[RecordSpectra], low: float, high: float, *, transient: bool = True
) -> LocalResponse:
    """Response of outputs to forces, at the nodes of each band; no ``transient`` of records at rest at both ends."""
    inside = [(record.frequency >= low) & (record.frequency <= high) for record in records]
    fewest = min(int(np.sum(lines)) for lines in inside)
    known = (SMOOTH_DEGREE + 1) * records[0].forces.shape[0]
    smooth = -(-known // len(records)) + (SMOOTH_DEGREE + 1) * transient  # in each record
    spare = 3  # lines of a narrowest band beyond its unknowns
    needed = smooth + spare + (_usually_seen(records, inside) if transient else 0)
    if fewest < needed:
        raise ValueError(
            f"{fewest} spectral lines lie in the tested band, {significant(low, 4)} to {significant(high, 4)} rad/s, "
            f"{needed} are needed: the record is too short for the band it sweeps"
        )
    most = 512  # narrowest bands of a record; longer records have wider ones
    count = min(fewest // needed, most)
    edges = _between_tones(records, np.linspace(low, high, count + 1))
    count = edges.size - 1
    edges[-1] = np.nextafter(high, np.inf)
    poles = np.full(count, np.nan + 0j)
    for _ in range(1 if transient else POLE_PASSES):
        rough = _solver(records, edges, poles, transient)
        poles = _poles([rough(k, k + 1) for k in range(count)])
    fits = tile(count, _solver(records, edges, poles, transient))
    nodes = [fit.node.size for fit in fits]
    response = np.concatenate([fit.response for fit in fits], axis=2)
    noise = np.repeat(pooled_noise(fits), nodes, axis=1)
    if not transient:  # wide bands, in which neighbours that respond less would hide the noise of the measured force
        noise = np.maximum(noise, np.sqrt(records[0].force_noise) * np.abs(response[0]))
    covariance = np.concatenate([fit.covariance for fit in fits], axis=2)
    left = [np.full(record.outputs.shape, np.nan + 0j) for record in records]
    for fit in fits:
        begin = 0
        for part, lines in zip(left, fit.lines, strict=True):
            part[:, lines] = fit.residual[:, begin : (begin := begin + lines.stop - lines.start)]
    step = float(records[0].frequency[1] - records[0].frequency[0])
    return LocalResponse(
        frequency=np.concatenate([fit.node for fit in fits]),
        response=response,
        sigma=noise * np.sqrt(np.einsum("jjl->jl", covariance).real / 2)[:, None],
        covariance=covariance,
        noise=noise,
        width=np.repeat([step * (fit.lines[0].stop - fit.lines[0].start) for fit in fits], nodes),
        residual=tuple(left),
    )


def _between_tones(records: Sequence[RecordSpectra], edges: Float) -> Float:
    """Edges of bands that hold as many tones of a multisine as a polynomial has coefficients, so that the nodes are the
    tones; the edges as they are under other forces, and where the tones lie closer."""
    least = 0.01  # power of a line over the loudest one's, from which it is of a tone
    record = records[0]
    inside = (record.frequency >= edges[0]) & (record.frequency <= edges[-1])
    power, lines = np.sum(np.abs(record.forces[:, inside]) ** 2, axis=0), record.frequency[inside]
    held = np.flatnonzero(power >= least * power.max(initial=0.0))
    apart = np.diff(held)
    tones = np.split(lines[held], np.flatnonzero(apart > 1) + 1)
    bands = len(tones) // (SMOOTH_DEGREE + 1)
    # A sweep falls into pieces too, some longer than what parts them; tones are narrower than their distance.
    if not 1 <= bands < edges.size or max(tone.size for tone in tones) > apart[apart > 1].min(initial=lines.size) - 1:
        return edges
    gaps = np.array([(one[-1] + other[0]) / 2 for one, other in pairwise(tones)])
    return np.concatenate([edges[:1], gaps[SMOOTH_DEGREE :: SMOOTH_DEGREE + 1][: bands - 1], edges[-1:]])


def gauss_nodes(position: Float, weight: Float, count: int) -> Float:
    """Zeros of the polynomial of degree ``count`` that is orthogonal with these weights (Golub and Welsch 1969)."""
    weight = weight / weight.sum()
    before, now, step = np.zeros_like(position), np.ones_like(position), 0.0
    diagonal, beside = [], []
    for _ in range(count):
        diagonal.append(float(weight @ (position * now**2)))
        new = (position - diagonal[-1]) * now - step * before
        step = float(np.sqrt(weight @ new**2))
        beside.append(step)
        before, now = now, new / step
    jacobi = np.diag(diagonal) + np.diag(beside[:-1], 1) + np.diag(beside[:-1], -1)
    return np.asarray(np.linalg.eigvalsh(jacobi))


def _poles(narrow: Sequence[LocalFit]) -> ComplexArray:
    """Pole nearest to each narrow band, from what it and its neighbours show; NaN where none is near."""
    node, response = (np.array([getattr(fit, name) for fit in narrow]) for name in ("node", "response"))
    leverage = np.array([fit.leverage for fit in narrow])
    sigma = pooled_noise(narrow).T[:, None, :, None] * np.sqrt(leverage / 2)[:, :, None]
    beside = 3  # narrow bands on either side in which the nearest pole is looked for
    first = np.maximum(np.arange(len(narrow)) - beside, 0)
    size = np.minimum(np.arange(len(narrow)) + beside + 1, len(narrow)) - first
    found = np.full(len(narrow), np.nan + 0j)
    for bands in np.unique(size).tolist():
        if bands * node.shape[1] > 2 * (SMOOTH_DEGREE + 2):
            some = np.flatnonzero(size == bands)
            near = first[some, None] + np.arange(bands)
            channels = [
                np.moveaxis(values[near], 1, -2).reshape(some.size, -1, bands * node.shape[1])
                for values in (response, sigma)
            ]
            found[some] = nearest_poles(node[near].reshape(some.size, -1), *channels)
    return found


def _solver(
    records: Sequence[RecordSpectra], edges: Float, poles: ComplexArray, transient: bool
) -> Callable[[int, int], LocalFit]:
    """A function that fits a band from one of the edges to another, with the pole nearest to its middle."""
    greatest = [np.abs(record.others).max(axis=1, initial=0.0) for record in records]
    borders = [np.searchsorted(record.frequency, edges) for record in records]
    known = (SMOOTH_DEGREE + 1) * records[0].forces.shape[0]
    smooth = -(-known // len(records)) + (SMOOTH_DEGREE + 1) * transient

    def solve(first: int, last: int) -> LocalFit:
        lines = tuple(slice(int(border[first]), int(border[last])) for border in borders)
        middle, half = (edges[first] + edges[last]) / 2, (edges[last] - edges[first]) / 2
        position = [(r.frequency[part] - middle) / half for r, part in zip(records, lines, strict=True)]
        pole = (poles[(first + last) // 2] - middle) / half
        powers = [_basis(at, pole) for at in position]
        own = []  # of each record: its transient, and spectra that are locked to the shaft
        for record, part, p, top in zip(records, lines, powers, greatest, strict=True):
            some = seen(record.others[:, part].T, p, top, len(p) - smooth - 1) if transient else p[:, :0]
            own.append(np.hstack([p, some]) if transient else some)
        begin = np.cumsum([(0, known), *(some.shape for some in own)], axis=0)
        matrix: ComplexArray = np.zeros(begin[-1], dtype=complex)
        for record, part, p, some, (row, column) in zip(records, lines, powers, own, begin[:-1].tolist(), strict=True):
            forced = record.forces[:, part, None] * p  # one force after the other
            matrix[row : row + len(p), :known] = forced.transpose(1, 0, 2).reshape(len(p), -1)
            matrix[row : row + len(p), column : column + some.shape[1]] = some
        measured = np.hstack([r.outputs[:, part] for r, part in zip(records, lines, strict=True)]).T
        scale = np.linalg.norm(matrix, axis=0)
        q, r = np.linalg.qr(matrix / np.where(scale > 0, scale, 1.0))
        if np.abs(np.diag(r)).min(initial=1.0) < ROUND_OFF:
            raise ValueError(
                f"most spectral lines from {significant(edges[first], 4)} to {significant(edges[last], 4)} rad/s are "
                "without force, as of periods that repeat exactly: give one period, or a test that begins and ends "
                "elsewhere"
            )
        noise = [np.sqrt(r.force_noise) * p for r, p in zip(records, powers, strict=True)]
        solving = _without_noise(r, np.vstack(noise), scale[:known]) if records[0].force_noise else np.linalg.inv(r)
        inverse = solving[:known] / scale[:known, None]
        projected = q.conj().T @ measured
        weight = np.concatenate(
            [np.abs(r.forces[0, part] * p[:, 0]) ** 2 for r, part, p in zip(records, lines, powers, strict=True)]
        )
        node = gauss_nodes(np.concatenate(position), weight, SMOOTH_DEGREE + 1)
        at_node = _basis(node, pole) @ inverse.reshape(-1, SMOOTH_DEGREE + 1, matrix.shape[1])
        return LocalFit(
            node=middle + half * node,
            response=(at_node @ projected).swapaxes(1, 2),
            covariance=np.einsum("jln,kln->jkl", at_node, at_node.conj()),
            residual=(measured - q @ (r @ (solving @ projected))).T,
            unknowns=matrix.shape[1],
            lines=lines,
        )

    return solve


def _without_noise(r: ComplexArray, noise: ComplexArray, scale: Float) -> ComplexArray:
    """Matrix that turns ``q^H Z`` into unknowns where the forces were measured with noise. Least squares would take the
    power of the noise for that of the force and find responses too small. What the noise adds to the normal equations
    on average is taken out of them (errors in variables), at most half of any direction."""
    size = noise.shape[1]
    extra = np.zeros_like(r)
    for first in range(0, scale.size, size):
        part = slice(first, first + size)
        extra[part, part] = (noise / scale[part]).conj().T @ (noise / scale[part])
    inverse = np.linalg.inv(r)
    worst = float(np.linalg.eigvalsh(inverse.conj().T @ extra @ inverse)[-1])
    return np.asarray(np.linalg.solve(r.conj().T @ r - min(1.0, 0.5 / worst) * extra, r.conj().T))


def _basis(position: Float, pole: complex) -> ComplexArray:
    """Polynomials over a band, divided by the distance from its pole where one is near."""
    powers = np.polynomial.legendre.legvander(position, SMOOTH_DEGREE).astype(complex)
    if not (abs(pole) < POLE_HALF_WIDTHS and pole.imag > LEAST_POLE_DISTANCE):
        return powers
    return np.asarray(powers / (1 - position / pole)[:, None])


def _usually_seen(records: Sequence[RecordSpectra], inside: Sequence[Bool]) -> int:
    """How many of the other inputs nine in ten pieces of the band have: few of a steady shaft, all of a start-up."""
    counts = [0]
    for record, lines in zip(records, inside, strict=True):
        greatest = np.abs(record.others).max(axis=1, initial=0.0)
        parts = np.array_split(np.flatnonzero(lines), max(int(lines.sum()) // (4 * (SMOOTH_DEGREE + 1)), 1))
        for part in parts:
            powers = _basis(np.linspace(-1, 1, part.size), complex(np.nan))
            counts.append(seen(record.others[:, part].T, powers, greatest, part.size).shape[1])
    return int(np.quantile(counts, 0.9))


def seen(columns: ComplexArray, powers: ComplexArray, greatest: Float, most: int) -> ComplexArray:
    """Spectra of inputs that a smooth transient cannot stand for, at most so many of them; their greatest lines say
    what counts."""
    rest = np.linalg.norm(columns - powers @ np.linalg.lstsq(powers, columns, rcond=None)[0], axis=0)
    strongest = np.argsort(-rest / np.maximum(greatest, 1e-300))[: max(most, 0)]
    return columns[:, [k for k in sorted(strongest.tolist()) if rest[k] > INPUT_AMPLITUDE_SHARE * greatest[k]]]


def nearest_poles(frequency: Float, response: ComplexArray, sigma: Float) -> ComplexArray:
    """Pole in the upper half-plane of w (a mode that decays) for each of several windows, NaN where the responses show
    none. Around a resonance every response is ``(smooth)/(w - p)`` with one pole p for all of them. From rough
    responses, ``w H = p H + q(w)`` with a quadratic q for each is linear in p and q (Levy's linearisation), weighted by
    ``1/(sigma |w - p|)`` with the p of the step before (Sanathanan and Koerner 1963). A pole that is a little off costs
    little: a smooth function over ``w - p`` stands for the responses as well as a polynomial does, and better.

    Args:
        frequency: of the points of each window, rad/s, shape ``(W, N)``.
        response, sigma: of each response, shape ``(W, C, N)``.
    """
    middle, half = frequency.mean(axis=1), np.ptp(frequency, axis=1) / 2
    x = (frequency - middle[:, None]) / half[:, None]
    powers = x[:, None, :, None] ** np.arange(SMOOTH_DEGREE + 1)
    pole, shown = np.zeros(middle.size, dtype=complex), np.ones(middle.size, dtype=bool)
    away = np.ones_like(x)
    for _ in range(4):
        weight = 1 / (sigma * away[:, None])
        q = np.linalg.qr(powers * weight[..., None])[0]
        # what is left of H and of x H beside the quadratics
        both = np.stack([response * weight, response * weight * x[:, None]], axis=-1)
        both -= q @ (q.swapaxes(-1, -2) @ both)
        top, bottom = (np.einsum("wcn,wcn->w", both[..., 0].conj(), both[..., k]) for k in (1, 0))
        shown &= np.abs(bottom) >= response[0].size  # else what is not smooth of the responses is their noise
        pole = np.divide(top, bottom, out=pole, where=shown)
        away = np.where(shown[:, None], np.abs(x - pole[:, None]), 1.0)
    return np.where(shown & (pole.imag > 0), middle + half * pole, complex(np.nan, np.nan))


def tile(count: int, solve: Callable[[int, int], LocalFit]) -> list[LocalFit]:
    """Bands that cover all lines, each fitted. A wide band needs fewer unknowns for the same lines, a narrow one
    follows a resonance. Neighbours are joined two by two where Akaike's criterion prefers one fit of both, from the
    narrowest bands up; then every joined band is halved again, because a bias too small to be seen in one band may yet
    be seen by a fit of all of them."""
    narrow = [solve(first, first + 1) for first in range(count)]
    noise = pooled_noise(narrow)
    chosen = {first: [(first, 1)] for first in range(count)}
    cost = {first: _criterion(narrow[first], noise[:, first]) for first in range(count)}
    doublings = 5  # times that bands may be doubled; chosen
    for length in (2**level for level in range(1, doublings + 1)):
        half = length // 2
        for first in range(0, count - length + 1, length):
            level = np.sqrt(np.mean(noise[:, first : first + length] ** 2, axis=1))
            together = _criterion(solve(first, first + length), level)
            apart, others = cost[first] + cost.pop(first + half), chosen.pop(first + half)
            cost[first] = min(together, apart)
            chosen[first] = [(first, length)] if together <= apart else chosen[first] + others
    found = []
    for first, length in (band for start in sorted(chosen) for band in chosen[start]):
        half = max(length // 2, 1)
        parts = range(first, first + length, half)
        found += [narrow[part] if half == 1 else solve(part, part + half) for part in parts]
    return found


def _criterion(fit: LocalFit, noise: Float) -> float:
    """Akaike's criterion over 2 with a known noise level, of all outputs together."""
    return float(np.sum(fit.misfit / noise**2) + 2 * fit.unknowns * noise.size)


def pooled_noise(fits: Sequence[LocalFit]) -> Float:
    """Noise ``sqrt(E |N|^2)`` of each output in each band, shape ``(P, bands)``. The nearest bands that together have
    :data:`POOLED_FREEDOM` degrees of freedom are pooled, but for those above their median (hum, an order of the shaft).
    A band that is clearly above its pool keeps its own level."""
    misfit = np.array([fit.misfit for fit in fits]).T
    dof = np.array([fit.dof for fit in fits], dtype=float)
    own = misfit / dof
    limit = 1 + SIGNIFICANT_ERRORS / np.sqrt(dof)
    total = np.concatenate([[0.0], np.cumsum(dof)])
    centre = (total[:-1] + total[1:]) / 2
    begin = np.clip(centre - POOLED_FREEDOM / 2, 0, max(total[-1] - POOLED_FREEDOM, 0))
    first = np.searchsorted(total, begin, side="right") - 1
    last = np.clip(np.searchsorted(total, begin + POOLED_FREEDOM), first + 1, dof.size)
    level = np.empty_like(own)
    for band, (start, stop) in enumerate(zip(first.tolist(), last.tolist(), strict=True)):
        near = slice(start, stop)
        kept = own[:, near] <= np.median(own[:, near], axis=1, keepdims=True) * limit[near]
        level[:, band] = np.sum(np.where(kept, misfit[:, near], 0.0), axis=1) / (kept @ dof[near])
    return np.asarray(np.sqrt(np.where(own > level * limit, own, level)))
