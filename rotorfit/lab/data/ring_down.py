"""Records of free vibration reduced to the eigenvalues of their modes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorfit.base.array_types import ComplexArray, Float, Index
from rotorfit.base.digits import significant
from rotorfit.estimators.signals.ring_down import Decay, decay_of
from rotorfit.lab.kinds.free_vibration import ImpulseTest, RingDownTest


def ring_down_modes(test: RingDownTest, *, modes: int = 1) -> ImpulseTest:
    """Reduce records of free vibration to eigenvalues, the strongest modes of each.

    Records begin after the impulse has ended. Steady vibration at one and two times the speed, left by unbalance, joins
    the sum where the record asks for it; what does not decay at these frequencies is no mode. Noise is what the sum
    leaves of the record: its level and its correlation from sample to sample give the errors of the eigenvalues.

    Args:
        test: the records.
        modes: modes wanted from each record, the strongest first.

    Returns:
        an impulse test, a row for each mode of each record.

    Raises:
        ValueError: unequal sampling, a record that is too short or has too few modes, or a strongest mode that is the
            turning of the shaft.

    Example:
        >>> rotor = rf.models.OneMode()
        >>> truth = {"M": 2.0, "K": 1e5, "Ds": 50.0, "K0": 2e4, "D": 800.0, "lam": 0.45, "Mf": 1.0}
        >>> records = rf.simulate(rotor, truth, "impulse", speed_rpm=[1500, 3000], impulse=0.01)
        >>> [f"{mode:.0f} rad/s" for mode in rf.ring_down_modes(records).frequency]
        ['167 rad/s', '196 rad/s']
    """
    rows: list[tuple[int, Decay, int]] = []
    for run in test.runs:
        here = np.flatnonzero(test.run == run)
        found = _analyse(test, here, run, modes)
        order = np.argsort(-found.energy)[:modes]
        rows += [(int(here[0]), found, int(k)) for k in order]
    first = np.array([row for row, _, _ in rows], dtype=np.intp)
    s = np.array([found.s[k] for _, found, k in rows])
    eps = test.eccentricity[first]
    centre = np.array([found.centre for _, found, _ in rows])
    return ImpulseTest(
        run=test.run[first],
        speed=test.speed[first],
        frequency=s.imag,
        damping_ratio=-s.real / np.abs(s),
        eccentricity=eps,
        position=np.where(np.isnan(eps), centre, complex(np.nan, np.nan)),
        sigma=np.array([found.sigma[k] for _, found, k in rows]),
        attributes={name: values[first] for name, values in test.attributes.items()},
        source=test.source,
    )


def _analyse(test: RingDownTest, rows: Index, run: str, modes: int) -> Decay:
    order = rows[np.argsort(test.time[rows], kind="stable")]
    time, signals = test.time[order] - test.time[order[0]], np.stack([test.x[order], test.y[order]])
    where = f"{test.source or 'ring-down records'}, run {run}"
    if time.size < 8 * (modes + 1) or not (np.isfinite(signals).all() and np.isfinite(time).all()):
        raise ValueError(f"{where}: {time.size} samples; at least {8 * (modes + 1)} finite ones are needed")
    steps = np.diff(time)
    if np.ptp(steps) > 1e-3 * steps.mean() or steps.mean() <= 0:
        raise ValueError(
            f"{where}: samples are {significant(steps.min(), 4)} to {significant(steps.max(), 4)} s apart; "
            "equal steps are needed"
        )
    if not np.ptp(signals, axis=1).any():
        raise ValueError(f"{where}: x and y do not move")
    if np.ptp(test.speed[rows]) > 1e-3 * abs(float(test.speed[rows[0]])):
        raise ValueError(f"{where}: the speed changes within the record")
    speed = abs(float(test.speed[rows[0]]))
    turns = speed * time[-1] / (2 * np.pi)
    orders = speed * np.array([k for k in (1, 2) if 2 * k * speed * steps.mean() < 2 * np.pi])
    fewest_turns = 2.0  # of the shaft in a record that can tell vibration at its speed from a mode's
    found = decay_of(time, signals, modes, orders if turns > fewest_turns else None)
    if found is None:
        raise ValueError(f"{where}: fewer than {modes} vibrating mode(s) found; the record may hold noise only")
    smallest_decay = 1e-4  # of the speed: decay and distance from it that count as none
    for k in np.argsort(-found.energy)[:modes].tolist():
        s, sigma = found.s[k], max(float(found.sigma[k]), smallest_decay * speed)
        if speed > 0 and any(abs(s.imag - order) < 4 * sigma and abs(s.real) < 4 * sigma for order in orders):
            raise ValueError(
                f"{where}: the vibration found at {significant(s.imag / speed, 4)} times the speed, damping ratio "
                f"{significant(-s.real / abs(s), 1)}, is unbalance within its error, not a mode. Take the 1x out, or "
                "give longer records"
            )
    return found


def ring_down_test(parts: Sequence[tuple[str, float, Float, ComplexArray]], source: str) -> RingDownTest:
    """Records one after the other: run, speed (rad/s), times (s) and motion ``x + jy`` (m) of each."""
    run, speed, time, motion = zip(*parts, strict=True)
    size, z = [each.size for each in time], np.concatenate(motion)
    return RingDownTest(
        run=np.repeat(run, size),
        speed=np.repeat(speed, size),
        time=np.concatenate(time),
        x=z.real,
        y=z.imag,
        eccentricity=np.full(z.size, np.nan),
        source=source,
    )
