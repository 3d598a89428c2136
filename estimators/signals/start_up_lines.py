"""Lines 1x and 2x of a start-up of a shaft that is not round, as if it had run at every speed for long.

A start-up is never steady: near a critical speed vectors lag, and what dK makes of the lagging motion lags twice. The
equation itself holds at any rate of the speed: with ``v = exp(2j theta) conj(z)``, taken from the measured motion,

    ``z'' + d z' + k z + delta v = eps (theta'^2 - j theta'') exp(j theta) + p``     (all divided by the mass)

is a linear rotor with known inputs. Local fits of z and of v to the orders give ``kappa A + delta B = eps Om^2``,
linear in k, d, delta and eps; two steps of least squares on the motion itself make them sharp. The start-up of that
shaft is computed and taken from the measured one, the rest goes through a local fit once more, and the shaft's steady
lines are added to it. Whatever the shaft has besides (more modes, twist, run-out) is in that rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from rotorfit.base.array_types import Bool, ComplexArray, Float
from rotorfit.base.digits import significant
from rotorfit.estimators.signals.local_response import LocalResponse, RecordSpectra, local_response
from rotorfit.estimators.signals.ratios import least_squares

_MOTION_TOLERANCE = 1e-9
"""Change of the computed motion over its size at which it is found: far below the noise of any record."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StartUp:
    """Motion of one plane in a start-up or a shutdown."""

    rate: float  # samples a second, Hz
    angle: Float  # of the shaft, rad, shape ``(N,)``
    speed: Float  # of the shaft, rad/s, shape ``(N,)``
    acceleration: Float  # of the shaft, rad/s^2, shape ``(N,)``
    motion: ComplexArray  # ``x + jy`` about its mean, m, shape ``(N,)``


@dataclass(frozen=True, kw_only=True)
class RoughShaft:
    """A shaft of mass one."""

    k: float  # stiffness over the mass, 1/s^2
    d: float  # damping over the mass, 1/s
    delta: complex  # ``dK exp(2jg)`` over the mass
    eps: complex  # eccentricity, m
    side: complex  # side load over the mass, m/s^2

    def kappa(self, w: Float) -> ComplexArray:
        """Dynamic stiffness of the round part."""
        return np.asarray(self.k + 1j * w * self.d - w**2)

    def steady(self, order: int, speed: Float) -> ComplexArray:
        """Line 1x or 2x at steady speeds, m."""
        kappa = self.kappa(order * speed)
        if order == 1:
            force = self.eps * speed**2
            return np.asarray(
                (kappa.conj() * force - self.delta * force.conj()) / (abs(kappa) ** 2 - abs(self.delta) ** 2)
            )
        sag = np.conj(self.side) / (self.k - abs(self.delta) ** 2 / kappa)
        return np.asarray(-self.delta * sag / kappa)


def start_up_lines(run: StartUp) -> dict[int, LocalResponse]:
    """Lines 1x and 2x of one response at steady speeds, m, by order, at frequencies of order times speed."""
    rough = _rough_shaft(run)
    for _ in range(2):  # steps of Gauss and Newton from there
        rough = _refined(rough, run)
    way = _Passage(rough, run)
    rest = run.motion - way.motion(rough.eps * way.unbalance + rough.side, _MOTION_TOLERANCE)[way.lead :]
    lines = {}
    for order in (1, 2):
        found = _local(run, np.array([rest, run.motion]), order)  # bands as narrow as the motion itself needs
        steady = rough.steady(order, found.frequency / order)
        scale = found.frequency**2 if order == 1 else np.ones(found.frequency.size)
        response, sigma = found.response[:1, :1] * scale + steady, found.sigma[:1, :1] * scale
        lines[order] = replace(found, response=response, sigma=sigma, covariance=found.covariance[:0, :0, :0])
    return lines


def _local(run: StartUp, outputs: ComplexArray, order: int) -> LocalResponse:
    """Responses to ``(theta'^2 - j theta'') exp(j theta)`` for 1x and to ``exp(2j theta)`` for 2x, its drive first."""
    drives = {1: (run.speed**2 - 1j * run.acceleration) * np.exp(1j * run.angle), 2: np.exp(2j * run.angle)}
    low, high = float(run.speed.min()), float(run.speed.max())
    step = 2 * np.pi * run.rate / run.angle.size
    frequency = np.asarray(step * np.arange(min(int(2.04 * high / step) + 2, run.angle.size // 2)), dtype=float)

    def spectrum(signal: ComplexArray) -> ComplexArray:
        return np.asarray(np.fft.fft(signal)[..., : frequency.size] / run.rate)

    both = [order, 3 - order]
    record = RecordSpectra(
        frequency=frequency,
        outputs=spectrum(outputs),
        forces=np.array([spectrum(drives[n]) for n in both]),
        others=spectrum(np.exp(3j * run.angle))[None],
    )
    return local_response([record], order * low, order * high)


def _rough_shaft(run: StartUp) -> RoughShaft:
    """The shaft whose equation of motion the local fits of motion and image obey."""
    image = np.exp(2j * run.angle) * run.motion.conj()
    once, twice = (_local(run, np.array([run.motion, image]), order) for order in (1, 2))
    square = once.frequency**2
    own, partner = np.concatenate([once.response[0] * square, twice.response[0]], axis=1)
    w = np.concatenate([once.frequency, twice.frequency])
    sigma = np.concatenate([once.sigma[0, 0] * square, twice.sigma[0, 0]])
    found, _, _ = shaft_of_lines(w, np.arange(w.size) < square.size, own, partner, sigma)
    return replace(found, side=found.side + found.delta * complex(image.mean()))


def shaft_of_lines(
    w: Float, first: Bool, own: ComplexArray, partner: ComplexArray, sigma: Float, *, runout: bool = True
) -> tuple[RoughShaft, complex, complex]:
    """Shaft whose equation lines 1x and 2x obey, by weighted linear least squares. ``kappa (A - R1) + delta (B -
    conj(R1)) = eps w^2`` and ``kappa (A2 - R2) + delta (B2 + conj(S)) = 0``, R1 and R2 run-out, S the sag about which
    the motion was taken; linear in k, d, delta and products of the rest with these."""
    powers = (0, 1, 2) if runout else None
    smooth = {(1, n): first * w**n + 0j for n in powers or (2,)} | {(2, n): ~first * w**n + 0j for n in powers or (0,)}
    complexes = [partner, *smooth.values()]
    columns = np.array([own, 1j * w * own, *(f * column for column in complexes for f in (1.0, 1j))])
    weight = 1 / (sigma * w**2)
    for _ in range(6):  # rounds of reweighting of the equation errors
        x = least_squares((columns * weight).T, own * w**2 * weight, real=True)
        k, d, delta = float(x[0]), float(x[1]), complex(x[2], x[3])
        weight = 1 / (sigma * np.hypot(np.abs(k + 1j * w * d - w**2), abs(delta)))
    if not (k > 0 and d > 0):
        raise ValueError(
            f"the motion gives a stiffness over mass of {significant(k, 4)} 1/s^2 and a damping of "
            f"{significant(d, 4)} 1/s"
        )
    constants = dict(zip(smooth, (x[4::2] + 1j * x[5::2]).tolist(), strict=True))
    right = -constants.get((1, 0), 0j)  # k R1 + delta conj(R1)
    R1 = (k * right - delta * right.conjugate()) / (k**2 - abs(delta) ** 2)
    R2 = constants.get((2, 2), 0j)
    sag = ((constants[2, 0] + k * R2) / delta).conjugate() if delta else 0j
    return RoughShaft(k=k, d=d, delta=delta, eps=R1 - constants[1, 2], side=k * sag), R1, R2


class _Passage:
    """A shaft in the turning of a start-up, at steady speed before it began."""

    def __init__(self, shaft: RoughShaft, run: StartUp) -> None:
        # Time constants of free motion that precede and follow the record in the computed start-up.
        time_constants = 12.0
        self.lead = int(time_constants * 2 / shaft.d * run.rate)
        before = np.arange(-self.lead, 0) / run.rate
        angle = np.concatenate([run.angle[0] + run.speed[0] * before, run.angle])
        rate = np.concatenate([np.full(self.lead, run.speed[0] ** 2), run.speed**2 - 1j * run.acceleration])
        self.size = angle.size
        w = np.asarray(2 * np.pi * np.fft.fftfreq(self.size + self.lead, 1 / run.rate))
        self.s, self.receptance = np.asarray(1j * w), 1 / shaft.kappa(w)
        self.unbalance, self.turn, self.delta = rate * np.exp(1j * angle), np.exp(2j * angle), shaft.delta

    def spread(self, signal: ComplexArray, factor: ComplexArray) -> ComplexArray:
        """A signal through a filter given by its frequency response, shape ``(..., N)``."""
        return np.asarray(np.fft.ifft(factor * np.fft.fft(signal, self.receptance.size))[..., : self.size])

    def motion(self, force: ComplexArray, settled: float) -> ComplexArray:
        """Motion under forces over the mass, by passes through the round part with the pull of the rest as a force."""
        motion = self.spread(force, self.receptance)
        for _ in range(400):
            new = self.spread(force - self.delta * self.turn * motion.conj(), self.receptance)
            change = float(np.abs(new - motion).max() / np.abs(new).max())
            motion = new
            if change < settled:
                return motion
            if not np.isfinite(change):
                break
        raise ValueError("the shaft that the motion gives runs away between its critical speeds; stay below them")


def _refined(shaft: RoughShaft, run: StartUp) -> RoughShaft:
    """One step of Gauss and Newton on the motion itself; run-out and mean position are fitted beside the shaft."""
    way = _Passage(shaft, run)
    z = way.motion(shaft.eps * way.unbalance + shaft.side, _MOTION_TOLERANCE)
    pull, steady = -way.turn * z.conj(), np.ones(z.size)
    forces = np.array(
        [-z, -way.spread(z, way.s), pull, 1j * pull, way.unbalance, 1j * way.unbalance, steady, 1j * steady]
    )
    tolerance = 1e-4  # change of the slopes over their size: they only lead to the next step
    slopes = way.motion(forces, tolerance)[:, way.lead :]
    other = np.array([np.exp(1j * n * run.angle) for n in (0, 1, 2)])
    x = least_squares(np.concatenate([slopes, other, 1j * other]).T, run.motion - z[way.lead :], real=True)
    return RoughShaft(
        k=shaft.k + float(x[0]),
        d=shaft.d + float(x[1]),
        delta=shaft.delta + complex(x[2], x[3]),
        eps=shaft.eps + complex(x[4], x[5]),
        side=shaft.side + complex(x[6], x[7]),
    )
