"""Frequency responses of a swept test by local models of the spectrum: no sweep bias, and errors that are known.

The spectra of a whole record obey ``Z(w) = H(w) F(w) + T(w) + sum_i c_i U_i(w) + noise``: H the frequency response, F
the force, T the transient (what the rotor did before the record began and will do after it), both smooth, and U_i the
spectra of what is locked to the shaft (run-out, residual unbalance). In a band of lines H and T are polynomials and the
c_i constants; linear least squares gives them, and the noise level from what is left (local polynomial method,
R. Pintelon and J. Schoukens, System Identification, 2nd ed., 2012, ch. 7). How fast the frequency was swept is nowhere
in it.

Two choices of ours:

- Bands do not slide but tile the axis (:mod:`rotorfit.estimators.band_tiling`), and H is reported at the zeros of the
  polynomial of degree R + 1 that is orthogonal with the weight ``|F|^2`` on the lines of the band (Gauss nodes). By the
  Christoffel-Darboux identity the R + 1 estimates of a band are uncorrelated there, so that a fit may take them for
  independent; they hold all that the band knows; and the leading term that the polynomial leaves out vanishes there.
- The noise level of a band is pooled with its neighbours' unless it is clearly above them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rotorfit.estimators.band_tiling import pooled_noise, tile

Float = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

DEGREE = 2
"""Degree of the polynomials for H and T."""

NARROWEST = 9
"""Lines in the narrowest band: six unknowns for degree 2, three left for the noise."""

MOST_BANDS = 1024
"""Narrowest bands of a record; longer records have wider ones."""

SEEN = 3e-3
"""An input counts in a band where what is not smooth of its spectrum exceeds this fraction of its greatest line."""


@dataclass(frozen=True, kw_only=True, eq=False)
class LocalResponse:
    """Frequency responses at the nodes of the bands.

    Attributes:
        frequency: of each node, rad/s, shape ``(L,)``, ascending.
        response: H, output over force, shape ``(P, L)``.
        sigma: standard deviation of its real part and of its imaginary part, shape ``(P, L)``.
        noise: noise of the spectrum of each output around the node, ``sqrt(E |N|^2)``, shape ``(P, L)``.
        width: width of the band around each node, rad/s, shape ``(L,)``.
        residual: what is left of the spectra on all lines, shape ``(P, K)``.
    """

    frequency: Float
    response: ComplexArray
    sigma: Float
    noise: Float
    width: Float
    residual: ComplexArray


@dataclass(frozen=True, kw_only=True, eq=False)
class LocalFit:
    """Least squares in one band of K lines.

    Attributes:
        lines: where the band is.
        node: frequencies of the nodes, rad/s.
        response: H there, shape ``(P, nodes)``.
        leverage: variance of H over that of the noise of the spectrum, at each node.
        residual: shape ``(P, K)``.
        unknowns: number of complex unknowns for each output.
    """

    lines: slice
    node: Float
    response: ComplexArray
    leverage: Float
    residual: ComplexArray
    unknowns: int

    @property
    def dof(self) -> int:
        """Complex degrees of freedom left for the noise, for each output."""
        return int(self.residual.shape[1]) - self.unknowns

    @property
    def misfit(self) -> Float:
        """Sum of squares of the residual of each output."""
        return np.asarray(np.sum(np.abs(self.residual) ** 2, axis=1))


def local_response(
    frequency: Float,
    outputs: ComplexArray,
    force: ComplexArray,
    others: Sequence[ComplexArray] = (),
    *,
    degree: int = DEGREE,
    narrowest: int = NARROWEST,
) -> LocalResponse:
    """Frequency response of each output to the force.

    Args:
        frequency: of the lines of the spectra, rad/s, equally spaced, shape ``(K,)``.
        outputs: spectra of the outputs over the whole record, shape ``(P, K)``.
        force: spectrum of the force, shape ``(K,)``.
        others: spectra of further inputs, to which the response is constant within a band, each of shape ``(K,)``.
        degree: degree of the polynomials for H and T.
        narrowest: lines in the narrowest band.

    Returns:
        responses at ``degree + 1`` nodes a band.

    Raises:
        ValueError: fewer lines than one band needs.
    """
    narrowest = max(narrowest, 2 * (degree + 1) + 2, frequency.size // MOST_BANDS)
    if frequency.size < narrowest:
        raise ValueError(
            f"{frequency.size} spectral lines lie in the tested band, {narrowest} are needed: the record is too short "
            "for the band it sweeps"
        )
    fits = tile(frequency.size, narrowest, _solver(frequency, outputs, force, others, degree))
    count = [fit.node.size for fit in fits]
    noise = np.repeat(pooled_noise(fits), count, axis=1)
    lines = [fit.residual.shape[1] for fit in fits]
    return LocalResponse(
        frequency=np.concatenate([fit.node for fit in fits]),
        response=np.concatenate([fit.response for fit in fits], axis=1),
        sigma=noise * np.sqrt(np.concatenate([fit.leverage for fit in fits]) / 2),
        noise=noise,
        width=np.repeat(np.asarray(lines) * float(frequency[1] - frequency[0]), count),
        residual=np.concatenate([fit.residual for fit in fits], axis=1),
    )


def gauss_nodes(position: Float, weight: Float, count: int) -> Float:
    """Zeros of the polynomial of degree ``count`` that is orthogonal with these weights (Golub and Welsch 1969).

    Args:
        position, weight: of the discrete measure, shape ``(K,)``, K > count.
        count: how many.
    """
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


def _solver(
    frequency: Float, outputs: ComplexArray, force: ComplexArray, others: Sequence[ComplexArray], degree: int
) -> Callable[[slice], LocalFit]:
    """A function that fits the band of the lines it is given."""
    greatest = [float(np.abs(spectrum).max(initial=0.0)) for spectrum in others]

    def solve(lines: slice) -> LocalFit:
        w, drive, measured = frequency[lines], force[lines], outputs[:, lines].T
        middle, half = (w[0] + w[-1]) / 2, (w[-1] - w[0]) / 2
        position = (w - middle) / half
        powers = np.polynomial.legendre.legvander(position, degree)
        shaft = [_seen(spectrum[lines], powers, SEEN * top) for spectrum, top in zip(others, greatest, strict=True)]
        matrix = np.hstack([powers * drive[:, None], powers, *shaft])
        scale = np.linalg.norm(matrix, axis=0)
        q, r = np.linalg.qr(matrix / scale)
        inverse = np.linalg.inv(r)[: degree + 1] / scale[: degree + 1, None]
        projected = q.conj().T @ measured
        node = gauss_nodes(position, np.abs(drive) ** 2, degree + 1)
        at_node = np.polynomial.legendre.legvander(node, degree) @ inverse
        return LocalFit(
            lines=lines,
            node=middle + half * node,
            response=(at_node @ projected).T,
            leverage=np.sum(np.abs(at_node) ** 2, axis=1),
            residual=(measured - q @ projected).T,
            unknowns=matrix.shape[1],
        )

    return solve


def _seen(column: ComplexArray, powers: Float, least: float) -> ComplexArray:
    """The input as a column, or no column where a smooth transient can stand for it."""
    rest = column - powers @ np.linalg.lstsq(powers, column, rcond=None)[0]
    return column[:, None] if np.linalg.norm(rest) > least else np.zeros((column.size, 0), complex)
