"""A sum of decaying vibrations in two signals, its amplitudes projected out (Kaufman 1975)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float

LARGEST_GROWTH = 1e6
"""Growth over the record beyond which an exponential is no motion of a rotor. Chosen."""


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
    """Residuals of a record and their derivatives by the eigenvalues of a sum of decaying vibrations. Eigenvalues are
    one vector ``u``: real and imaginary parts of the vibrating ones, then the real ones, over a scale."""

    def __init__(self, time: Float, signals: Float, s: ComplexArray, real: Float, steady: Float) -> None:
        """The sum for a record."""
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
