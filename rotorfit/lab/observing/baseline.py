"""A rig without its fluid, taken out of the test with it: the dry run's dynamic stiffness acts beside the model's.

``(kappa_dry + kappa) A = F``: what a dry run shows of stator, rods, pipes and housings is put beside the model line by
line, as it was measured, and the model is of the fluid alone. Where the dry run was made at other frequencies it is
interpolated by splines. With H the measured response of the whole rig, errors ``d`` of what was measured make

    predicted - measured = H dF - dA - H dkappa_dry A,    dkappa_dry = (dF_dry - kappa_dry dA_dry) A_dry^+

so that all readings that rest on the same lines of the dry run err together.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.digits import significant
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.estimators.blocks.correlated import CorrelatedResponses
from rotorfit.estimators.blocks.observations import Block, Responses
from rotorfit.estimators.blocks.set_speeds import SPEED_TOLERANCE
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.synchronous import SAME_RATE
from rotorfit.lab.observing.circular import observe
from rotorfit.models import RotorModel

MOST_CORRELATED = 4000
"""Readings whose errors may hang together: their covariance then takes a quarter of a gigabyte."""
_FEWEST_KNOTS = 4
"""Lines of a dry run through which a cubic goes."""


@dataclass(frozen=True, eq=False, kw_only=True)
class _Line:
    """Dynamic stiffness of the dry rig at one frequency, and what it was made of."""

    frequency: float  # rad/s, signed where the model's is
    kappa: ComplexArray  # shape ``(n, n)``
    back: ComplexArray  # pseudo-inverse of the amplitudes, shape ``(runs, n)``
    force_noise: ComplexArray  # covariance of the forces of each run, shape ``(runs, n, n)``
    sigma: Float  # noise of the amplitudes, shape ``(runs, n)``

    def spread(self, run: int) -> ComplexArray:
        """Covariance of ``dF - kappa dA`` of a run, shape ``(n, n)``."""
        return np.asarray(self.force_noise[run] + (self.kappa * self.sigma[run] ** 2) @ self.kappa.conj().T)

    @cached_property
    def variance(self) -> float:
        """Mean variance of the parts of the entries of kappa."""
        weight = np.sum(np.abs(self.back) ** 2, axis=1)
        total = sum(w * float(np.trace(self.spread(run)).real) for run, w in enumerate(weight.tolist()))
        return float(total) / self.kappa.size


@dataclass(frozen=True, eq=False, kw_only=True)
class _Dry:
    """Lines of the dry run that stand beside the lines of a test."""

    lines: tuple[_Line, ...]
    share: Float  # of each of them in each line of the test, shape ``(L, N)``
    remarks: tuple[str, ...]
    source: str  # what it is called in sentences


def with_baseline(
    model: RotorModel, block: Block, test: Experiment, baseline: PerturbationTest | None, mass: float | None
) -> Block:
    """Observations with the rig's own dynamic stiffness beside the model's, and with the noise of measured forces."""
    base, responses = block.linear, test.perturbation
    if base is None or base is not block or responses is None:
        if baseline is None and mass is None:
            return block
        raise ValueError(
            f"{test.source or test.title}: a rig's own dynamic stiffness (baseline, stator_mass_kg) can be taken out "
            "of responses to measured forces, with models without a law of eccentricity"
        )
    if mass is not None:
        if len(model.planes) > 1:
            raise ValueError(f"stator_mass_kg is the mass at one plane, {model.name} has {', '.join(model.planes)}")
        moving = np.diag([float(coordinate.axis != "r") for coordinate in model.coordinates])
        base = replace(base, beside=np.asarray((mass * base.s**2)[:, None, None] * moving))
    dry = None
    if baseline is not None:
        dry = _beside(model, base, responses, baseline)
        kappa = np.array([line.kappa for line in dry.lines])
        base = replace(base, beside=np.einsum("ln,nij->lij", dry.share, kappa), beside_read=True)
    return base if dry is None and base.force_noise is None else _correlated(base, responses, dry)


# ---- the dry run beside each line -----------------------------------------------------------------------------------


def _beside(model: RotorModel, block: Responses, test: PerturbationTest, baseline: PerturbationTest) -> _Dry:
    _refuse_other_rig(test, baseline)
    dry = observe(model, baseline, np.zeros(len(baseline), dtype=np.intp))
    speeds = np.unique(dry.set_speed)
    found: list[_Line] = []
    share = np.zeros((block.speed.size, 0))
    remarks: tuple[str, ...] = ()
    for speed in np.unique(block.set_speed).tolist():
        mine = np.flatnonzero(block.set_speed == speed)
        nearest = float(speeds[np.argmin(np.abs(speeds - speed))])
        if abs(nearest - speed) > SPEED_TOLERANCE * max(abs(speed), abs(nearest)):
            if speeds.size > 1:
                there = ", ".join(significant(value * RPM_PER_RAD_S, 5) for value in speeds.tolist())
                raise ValueError(
                    f"{baseline.source or 'the dry run'} was made at {there} rpm, {test.source or 'the test'} has "
                    f"{significant(speed * RPM_PER_RAD_S, 5)} rpm: dry runs at several speeds are matched with those "
                    "of the test; add the run, or give a dry run at one speed for all"
                )
            remarks = (
                f"the dry run {baseline.source} was made at {significant(nearest * RPM_PER_RAD_S, 4)} rpm alone and "
                "stands for all speeds",
            )
        for forward in (True, False):
            lines = mine[(block.frequency[mine] >= 0) == forward]
            if not lines.size:
                continue
            # Forces of either sense make one matrix of x and y.
            same_sense = ((dry.frequency >= 0) == forward) | (model.frame != "z")
            own = _stiffness_lines(dry, np.flatnonzero((dry.set_speed == nearest) & same_sense), baseline)
            # Dynamic stiffness is one curve over the signed frequency in z, over its size in x and y.
            knots, w = np.array([line.frequency for line in own]), block.s.imag[lines]
            _refuse_outside(knots, w, test, baseline)
            part = np.hstack([_shares(knots, w), _between(knots, w)])
            own += _truncation(own, knots)
            share = np.pad(share, ((0, 0), (0, len(own))))
            share[np.ix_(lines, np.arange(len(found), len(found) + len(own)))] = part
            found += own
    source = f"the dry run {baseline.source}".rstrip()
    return _Dry(lines=tuple(found), share=share, remarks=remarks, source=source)


def _stiffness_lines(dry: Responses, lines: Index, baseline: PerturbationTest) -> list[_Line]:
    """Dynamic stiffness at each frequency of the dry run, by its runs there (eq. 7)."""
    amplitude, sigma = dry.amplitudes()
    n, w = amplitude.shape[1], dry.s.imag
    order = lines[np.argsort(w[lines], kind="stable")]
    new = np.diff(w[order]) > SAME_RATE * np.abs(w[order[1:]])
    found = []
    for own in np.split(order, np.flatnonzero(new) + 1) if order.size else []:
        A, F = amplitude[own].T, dry.force[own].T  # (n, runs)
        if not np.isfinite(A).all() or np.linalg.matrix_rank(A) < n:
            continue
        back = np.linalg.pinv(A)
        noise = np.zeros((own.size, n, n), dtype=complex) if dry.force_noise is None else dry.force_noise[own]
        mean, kappa = float(np.mean(w[own])), np.asarray(F @ back)
        found.append(_Line(frequency=mean, kappa=kappa, back=np.asarray(back), force_noise=noise, sigma=sigma[own]))
    if not found:
        raise ValueError(
            f"{baseline.source or 'the dry run'}: its dynamic stiffness takes a force at each plane in turn"
            + (", along x and along y at the same frequencies" if dry.model.frame != "z" else "")
            + f", all of {', '.join(dry.model.planes)} being read"
        )
    return found


_BEYOND = 0.1
"""Share of the gap at an end of the dry run by which it may be continued there: lines of one multisine, or ends of one
sweep, are read a little apart. Chosen: the error is less than that amid the gap."""


def _refuse_outside(knots: Float, w: Float, test: PerturbationTest, baseline: PerturbationTest) -> None:
    gaps = np.diff(knots)[[0, -1]] if knots.size > 1 else np.zeros(2)
    low, high = np.maximum(SAME_RATE * np.abs(knots).max(), _BEYOND * gaps)
    outside = (w < knots[0] - low) | (w > knots[-1] + high)
    if outside.any():
        ends = np.sort(np.abs(knots[[0, -1]])) / (2 * np.pi)
        digits = 10.0 ** (np.floor(np.log10(np.maximum(ends, 1e-3))) - 3)
        low, high = np.ceil(ends[0] / digits[0]) * digits[0], np.floor(ends[1] / digits[1]) * digits[1]
        off, low_hz, high_hz = (significant(hz, 4) for hz in (np.abs(w[outside][0]) / (2 * np.pi), low, high))
        raise ValueError(
            f"{baseline.source or 'the dry run'} goes from {low_hz} to {high_hz} Hz, {test.source or 'the test'} has "
            f"{off} Hz: a baseline is not extrapolated; leave these readings out (where={{'frequency_hz': ({low_hz}, "
            f"{high_hz})}}, --where frequency_hz={low_hz}:{high_hz}), or repeat the dry run"
        )


def _shares(knots: Float, w: Float) -> Float:
    """Shares of values at knots in those at frequencies, by cubic splines, shape ``(L, N)``."""
    if knots.size < _FEWEST_KNOTS:
        return np.stack([np.interp(w, knots, unit) for unit in np.eye(knots.size)], axis=1)
    from scipy.interpolate import CubicSpline  # late: loading it takes longer than a fit

    found = np.asarray(CubicSpline(knots, np.eye(knots.size))(w))
    nearest = np.argmin(np.abs(w[:, None] - knots), axis=1)
    there = np.abs(w - knots[nearest]) <= SAME_RATE * np.abs(w)
    found[there] = np.eye(knots.size)[nearest[there]]
    return found


def _between(knots: Float, w: Float) -> Float:
    """How far each frequency is inside each gap between knots or a little beyond the ends, one in the middle of a gap,
    shape ``(L, N - 1)``."""
    along = (w[:, None] - knots[:-1]) / np.diff(knots)
    inside = (along > 0) & (along < 1)
    inside[:, :1] |= along[:, :1] <= 0
    inside[:, -1:] |= along[:, -1:] >= 1
    return np.where(inside, (4 * along * (1 - along)) ** 2, 0.0)


def _truncation(lines: list[_Line], knots: Float) -> list[_Line]:
    """Errors of interpolation in each gap as lines of stiffness zero: a cubic beside a knot left out misses it by 4
    h^4/24 of the fourth derivative, one through all misses the middle by 9/16 of h^4/24: 9/64 of it, less the noise."""
    n = lines[0].kappa.shape[0]
    power = np.zeros(knots.size)
    for i in range(1, knots.size - 1) if knots.size > _FEWEST_KNOTS else ():
        rest = np.delete(np.arange(knots.size), i)
        share = _shares(knots[rest], knots[i : i + 1])[0]
        miss = lines[i].kappa - np.einsum("n,nij->ij", share, np.array([lines[k].kappa for k in rest]))
        noise = lines[i].variance + sum(share[k] ** 2 * lines[j].variance for k, j in enumerate(rest.tolist()))
        power[i] = max(float(np.mean(np.abs(miss) ** 2)) / 2 - noise, 0.0)
    size = (9 / 64) ** 2 * np.maximum(power[:-1], power[1:])
    unit = np.eye(n, dtype=complex)
    return [
        _Line(
            frequency=math.nan,
            kappa=np.zeros((n, n), dtype=complex),
            back=unit,
            force_noise=np.tile(own * unit, (n, 1, 1)),
            sigma=np.zeros((n, n)),
        )
        for own in size.tolist()
    ]


def _refuse_other_rig(test: PerturbationTest, baseline: PerturbationTest) -> None:
    """Refuse a dry run that is not of the rig of the test, or no dry run at all."""
    wet, dry = test.source or "the test", baseline.source or "the dry run"
    for what, one, other in (
        ("reads", test.planes, baseline.planes),
        ("forces", test.force_planes, baseline.force_planes),
    ):
        if set(one) != set(other):
            raise ValueError(
                f"{dry} {what} {', '.join(other)}, {wet} {what} {', '.join(one)}: a dry run is one of the same rig, "
                "with the same planes"
            )
    if len(test) == len(baseline) and np.array_equal(test.response, baseline.response):
        raise ValueError(f"{dry} has the readings of {wet}: the test was given as its own dry run")


# ---- errors ---------------------------------------------------------------------------------------------------------


def _correlated(block: Responses, test: PerturbationTest, dry: _Dry | None) -> Block:
    """Observations with the errors of forces and of the dry run beside those of the readings."""
    n = len(block.model.coordinates)
    noise = block.force_noise
    H = _measured_receptance(block, test, whole=dry is not None)
    if dry is None and n == 1 and noise is not None:  # a force of its own for each reading
        more = np.abs(H[block.line, 0, 0]) ** 2 * noise[block.line, 0, 0].real
        return replace(block, sigma=np.sqrt(block.sigma**2 + more))
    if block.measured.size > MOST_CORRELATED:
        raise ValueError(
            f"{test.source or 'the test'} has {block.measured.size} readings whose errors hang together by forces and "
            f"dry run; up to {MOST_CORRELATED} can be weighed: take fewer frequencies, or fit speeds one by one"
        )
    covariance: ComplexArray = np.diag(block.sigma**2).astype(complex)
    rows = H[block.line, block.coordinate]  # (R, n)
    if noise is not None:
        same = block.line[:, None] == block.line
        covariance += same * np.einsum("ri,rij,sj->rs", rows, noise[block.line], rows.conj())
    if dry is not None:
        covariance += _dry_covariance(block, rows, dry)
    sigma = np.sqrt(covariance.diagonal().real)
    source = "the dry run" if dry is None else dry.source
    correlation: ComplexArray = covariance / np.outer(sigma, sigma)
    return CorrelatedResponses(
        base=replace(block, sigma=sigma),
        correlation=correlation,
        covariance=correlation,
        degrees=math.inf,
        weight_freedom=math.inf,
        notes=() if dry is None else (f"{source} is taken out, its noise counts", *dry.remarks),
    )


def _dry_covariance(block: Responses, rows: ComplexArray, dry: _Dry) -> ComplexArray:
    """Covariance that readings have by the errors of the dry run's lines, shape ``(R, R)``."""
    amplitude, _ = block.amplitudes()
    found = np.zeros((block.measured.size, block.measured.size), dtype=complex)
    for number, line in enumerate(dry.lines):
        at = np.flatnonzero(dry.share[block.line, number])
        if not at.size:
            continue
        # H (dF - kappa dA) A_dry^+ A of each reading and run of the dry test
        motion = amplitude[block.line[at]] @ line.back.T * dry.share[block.line[at], number, None]  # (r, runs)
        for run in range(line.back.shape[0]):
            own = rows[at] * motion[:, run, None]
            found[np.ix_(at, at)] += own @ line.spread(run) @ own.conj().T
    return found


def _measured_receptance(block: Responses, test: PerturbationTest, *, whole: bool) -> ComplexArray:
    """Responses to unit forces at each line as they were measured, by all runs at its frequency, ``(L, n, n)``."""
    amplitude, _ = block.amplitudes()
    n, w = amplitude.shape[1], block.s.imag
    found = np.zeros((w.size, n, n), dtype=complex)
    keys = np.column_stack([block.group, block.set_speed, np.round(w, 6)])
    _, number = np.unique(keys, axis=0, return_inverse=True)
    for one in range(int(number.max()) + 1):
        at = np.flatnonzero(number.reshape(-1) == one)
        A, F = amplitude[at].T, block.force[at].T
        if whole and (np.linalg.matrix_rank(F) < n or not np.isfinite(A).all()):
            raise ValueError(
                f"{test.source or 'the test'}: at {significant(abs(w[at[0]]) / (2 * np.pi), 5)} Hz not all of "
                f"{', '.join(map(str, block.model.coordinates))} were forced in turn and read; beside a dry run a test "
                "has forces along both axes at the same frequencies"
            )
        found[at] = np.nan_to_num(A) @ np.linalg.pinv(F)
    return found
