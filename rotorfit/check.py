"""Look a test over before fitting: slips of sign, direction and scale that the data themselves give away.

The local physics behind it (conventions as in :mod:`rotorfit.experiments`): at a drive point, where the force acts
and is measured, ``kappa = F / A`` and ``Im kappa`` is what the rotor dissipates. It is negative under any backward
force, positive under a forward force faster than the rotor, and negative under a slower one only as far as the fluid
drives the rotor (``D (w - lam Omega)``, eq. 13). A conjugated FRF turns all these signs round; a reversed sense of
rotation moves the drive of the fluid to the backward side.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rotorfit.experiments import ComplexArray, DisplacementTest, Experiment, Float, PerturbationTest, Text
from rotorfit.synchronous import DIFFERENCED

NEAR_1X = 1e-3
"""Readings with |w| this close to the speed, as a fraction, are once-per-turn readings to a tracking filter."""

CERTAIN = 3.5
"""Sum of signs over its standard deviation under random signs, beyond which a sign is taken as established."""

ENOUGH = 12
"""Readings needed for a verdict on a run."""

SMALL_SINE = 0.1
"""Sine of the phase of kappa below which its sign says little."""

LARGEST, SUSPECT, SMALLEST = 0.05, 5e-3, 1e-10
"""Displacements, m: impossible, larger than any clearance in use, and smaller than any probe resolves."""

Index = NDArray[np.intp]


@dataclass(frozen=True)
class Finding:
    """One thing that :func:`check` noticed.

    Attributes:
        severity: ``error`` spoils every fit, ``warning`` spoils some or is likely a slip, ``note`` is good to know.
        code: short name of the kind of finding, for programs.
        message: what, where and what to do.
        rows: rows of the experiment concerned, for ``select``; empty if it is about the test as a whole.
    """

    severity: Literal["error", "warning", "note"]
    code: str
    message: str
    rows: tuple[int, ...] = ()

    def __str__(self) -> str:
        return f"{self.severity} [{self.code}] {self.message}"


def check(test: Experiment) -> list[Finding]:
    """Findings about a test, errors first.

    Recognised are readings that are not finite or doubled, forces of zero, implausible amplitudes, readings at 1x,
    gaps in the plan of the test (planes without force, one direction only, one frequency only), conjugated FRFs,
    responses in the wrong direction, a reversed sense of rotation, peak-to-peak amplitudes in some channels,
    start-ups without partner.

    Args:
        test: what was measured, SI units.
    """
    findings = list(_numbers(test))
    finite = np.flatnonzero(_finite(test))
    if isinstance(test, PerturbationTest | DisplacementTest) and finite.size:
        rest = test.select(finite)
        for finding in _physics(rest):
            # rows of the finite part back to rows of the test
            rows = tuple(finite[list(finding.rows)].tolist())
            findings.append(Finding(finding.severity, finding.code, finding.message, rows))
    order = ("error", "warning", "note")
    return sorted(findings, key=lambda finding: order.index(finding.severity))


def _physics(test: PerturbationTest | DisplacementTest) -> Iterator[Finding]:
    yield from _duplicates(test)
    yield from _amplitudes(test)
    yield from _frequencies(test)
    if isinstance(test, PerturbationTest):
        yield from _planes(test)
        yield from _start_ups(test)
        orbits = _orbits(test.select(test.force != 0), np.flatnonzero(test.force != 0))
        wrong = list(_wrong_direction(orbits))
        yield from wrong
        yield from _peak_to_peak(orbits)
        if not any(finding.severity == "error" for finding in wrong):  # else the right component is only a residue
            yield from _signs(orbits)


def _finite(test: Any) -> NDArray[np.bool_]:
    numeric = [getattr(test, name) for name in test._columns() if name != "sigma"]
    columns = [np.isfinite(values) for values in numeric if values.dtype.kind in "fc"]
    return np.logical_and.reduce(columns) if columns else np.ones(len(test), dtype=bool)


def _rows(mask: NDArray[Any]) -> tuple[int, ...]:
    return tuple(int(row) for row in np.flatnonzero(mask))


def _numbers(test: Experiment) -> Iterator[Finding]:
    if not len(test):
        yield Finding("error", "empty", "The test has no readings.")
        return
    bad = ~_finite(test)
    if bad.any():
        text = f"{bad.sum()} readings are not finite; remove them, test.select(...) with the rows to keep."
        yield Finding("error", "not-finite", text, _rows(bad))
    sigma = getattr(test, "sigma", np.array([1.0]))
    if (sigma <= 0).any():
        text = f"sigma is not positive in {(sigma <= 0).sum()} rows; NaN stands for unknown noise."
        yield Finding("error", "sigma", text, _rows(sigma <= 0))
    if isinstance(test, PerturbationTest) and (test.force == 0).any():
        text = f"The force is zero in {(test.force == 0).sum()} rows; remove them, they have no dynamic stiffness."
        yield Finding("error", "no-force", text, _rows(test.force == 0))


def _duplicates(test: PerturbationTest | DisplacementTest) -> Iterator[Finding]:
    columns = [getattr(test, name).tolist() for name in test._columns() if name != "sigma"]
    first: dict[Any, int] = {}
    again = np.array([first.setdefault(key, i) != i for i, key in enumerate(zip(*columns, strict=True))])
    if again.any():
        text = (
            f"{again.sum()} readings repeat an earlier row to the last digit; a copy is no second measurement and "
            "makes errors look smaller than they are. Remove them."
        )
        yield Finding("warning", "duplicate", text, _rows(again))


def _amplitudes(test: PerturbationTest | DisplacementTest) -> Iterator[Finding]:
    if isinstance(test, PerturbationTest):
        size, tilt = np.abs(test.response), np.char.startswith(test.direction, "r")
    else:
        size, tilt = np.abs(test.displacement), np.zeros(len(test), dtype=bool)
    size = np.where(tilt, size * 0.1, size)  # a slope of 0.5 rad is as impossible as 50 mm
    if size.max() > SUSPECT:
        severity: Literal["error", "warning"] = "error" if size.max() > LARGEST else "warning"
        text = (
            f"Amplitudes reach {size.max():.3g} m 0-peak; no rotor in a bearing or seal moves that far. Check the unit "
            "of the amplitude column (um, mil, m)."
        )
        yield Finding(severity, "large-amplitude", text, _rows(size > SUSPECT))
    elif 0 < size.max() < SMALLEST:
        text = f"The largest amplitude is {size.max():.3g} m, less than probes resolve. Check the unit of the column."
        yield Finding("warning", "small-amplitude", text)


def _frequencies(test: PerturbationTest | DisplacementTest) -> Iterator[Finding]:
    synchronous = isinstance(test, PerturbationTest) and test.synchronous
    turning = test.speed != 0
    near = turning & (np.abs(np.abs(test.frequency) - np.abs(test.speed)) <= NEAR_1X * np.abs(test.speed))
    if near.any() and not synchronous:
        text = (
            f"{near.sum()} readings are at once-per-turn frequency, where run-out and residual unbalance add to the "
            "response. Subtract the slow roll, read(..., slow_roll=...), or remove them."
        )
        yield Finding("warning", "near-1x", text, _rows(near))
    if not synchronous and (np.all(test.frequency >= 0) or np.all(test.frequency <= 0)):
        there, lacking = ("forward", "backward") if np.all(test.frequency >= 0) else ("backward", "forward")
        text = (
            f"All runs are {there}. {lacking.capitalize()} runs separate fluid damping from lam and anisotropy from "
            "both; without them parameters are less certain than the noise suggests."
        )
        yield Finding("warning", "one-direction", text)
    single = [run for run in test.runs if np.unique(np.round(test.frequency[test.run == run], 6)).size == 1]
    if single:
        text = f"Runs with one frequency only: {_list(single)}; they cannot show how dynamic stiffness varies with it."
        yield Finding("warning", "single-frequency", text, _rows(np.isin(test.run, single)))


def _planes(test: PerturbationTest) -> Iterator[Finding]:
    unforced = [plane for plane in test.planes if plane not in test.force_planes]
    if unforced:
        text = (
            f"No force was applied at {_list(unforced)}: eq. (7) needs a force at each measured plane in turn. A fit "
            "of a model still works, with parameters that may not be identifiable."
        )
        yield Finding("note", "force-planes", text)
    blind = [plane for plane in test.force_planes if plane not in test.planes]
    if blind:
        text = f"Forces act at {_list(blind)} where nothing is measured; there is no drive point to check signs at."
        yield Finding("note", "measured-planes", text)
    from rotorfit.csv_io import plane_groups

    groups = plane_groups(test)
    if len(groups) > 1:
        listed = "; ".join(", ".join(group) for group in groups)
        text = f"No run connects these planes: {listed}. If they belong to two rigs, fit them apart."
        yield Finding("warning", "unconnected-planes", text)


def _start_ups(test: PerturbationTest) -> Iterator[Finding]:
    if not test.synchronous:
        return
    raw = np.asarray(test.attributes.get(DIFFERENCED, np.zeros(len(test))) != 1)
    if raw.any():
        runs = tuple(dict.fromkeys(test.run[raw].tolist()))
        text = (
            f"Start-ups not differenced (eq. 20): {_list(runs)}. They contain residual unbalance, bow and run-out. Run "
            "them again with the weight moved by 180 degrees, or call difference_synchronous if both runs are there."
        )
        yield Finding("warning", "not-differenced", text, _rows(raw))


def _list(names: Sequence[str]) -> str:
    return ", ".join(names[:6]) + (f" and {len(names) - 6} more" if len(names) > 6 else "")


@dataclass(frozen=True, eq=False)
class _Orbits:
    """Readings of one plane at one frequency, x and y put together; arrays of one length.

    ``force``, ``right`` and ``wrong`` (the component in and against the direction of the force) are relative to
    exp(jwt) with w signed. ``wrong``, ``x`` and ``y`` are NaN where only one probe was read, which then counts as a
    circular orbit.
    """

    run: Text
    speed: Float
    frequency: Float
    force_plane: Text
    plane: Text
    force: ComplexArray
    x: ComplexArray
    y: ComplexArray
    right: ComplexArray
    wrong: ComplexArray
    rows: Sequence[tuple[int, ...]]

    def groups(self, *names: str) -> Iterator[tuple[tuple[str, ...], Index]]:
        """Indices by equal values of columns."""
        found: dict[tuple[str, ...], list[int]] = {}
        for i, key in enumerate(zip(*[getattr(self, name).tolist() for name in names], strict=True)):
            found.setdefault(key, []).append(i)
        for key, indices in found.items():
            yield key, np.array(indices)

    def rows_of(self, indices: Index) -> tuple[int, ...]:
        """Rows of the test behind orbits."""
        return tuple(sorted(row for i in indices.tolist() for row in self.rows[i]))


def _orbits(test: PerturbationTest, numbers: Index) -> _Orbits:
    found: dict[Any, dict[str, int]] = {}
    columns = (test.run, test.speed, test.frequency, test.force_plane, test.force, test.plane)
    keys = zip(*[column.tolist() for column in columns], strict=True)
    for row, (key, direction) in enumerate(zip(keys, test.direction.tolist(), strict=True)):
        if direction in ("x", "y", "z"):
            found.setdefault(key, {}).setdefault(direction, row)  # of repeats the first stands for all
    first = np.array([next(iter(rows.values())) for rows in found.values()], dtype=np.intp)

    def reading(direction: str) -> ComplexArray:
        values = [test.response[rows[direction]] if direction in rows else np.nan for rows in found.values()]
        return np.array(values, dtype=complex)

    x, y, z = reading("x"), reading("y"), reading("z")
    backward = test.frequency[first] < 0
    single = np.where(np.isnan(x), np.where(backward, -1j, 1j) * y, x)  # a circular orbit has Y = -j X, backward +j X
    plus, minus = (x + 1j * y) / 2, np.conj(x - 1j * y) / 2
    right = np.where(np.isnan(plus), np.where(backward, single.conj(), single), np.where(backward, minus, plus))
    force = np.where(backward, test.force[first].conj(), test.force[first])
    return _Orbits(
        run=test.run[first],
        speed=test.speed[first],
        frequency=test.frequency[first],
        force_plane=test.force_plane[first],
        plane=test.plane[first],
        force=force,
        x=x,
        y=y,
        right=np.where(np.isnan(right), z, right),
        wrong=np.where(backward, plus, minus),
        rows=[tuple(int(numbers[row]) for row in rows.values()) for rows in found.values()],
    )


def _wrong_direction(orbits: _Orbits) -> Iterator[Finding]:
    share: dict[tuple[str, ...], float] = {}
    for key, at in orbits.groups("run", "plane"):
        paired = at[np.isfinite(orbits.wrong[at])]
        if paired.size:
            right, wrong = np.sum(np.abs(orbits.right[paired]) ** 2), np.sum(np.abs(orbits.wrong[paired]) ** 2)
            share[key] = float(wrong / (right + wrong)) if right + wrong > 0 else 0.0
    bad = {key for key, part in share.items() if part > 0.8}  # short of that it may be strong anisotropy
    if bad:
        runs = list(dict.fromkeys(run for run, _ in bad))
        planes = list(dict.fromkeys(plane for _, plane in share if any(plane == p for _, p in bad)))
        hit = np.array([key in bad for key in zip(orbits.run.tolist(), orbits.plane.tolist(), strict=True)])
        everywhere = len(bad) == len(share)
        cause = (
            "phase lag read as lead (use phase_lag_deg), x and y probes exchanged, or the sign of the frequency"
            if everywhere
            else f"the probes at {_list(planes)}: x and y exchanged, one of them inverted, or phases as lag"
            if len(planes) < len({plane for _, plane in share})
            else "the sign of the frequency in these runs, or phases given as lag"
        )
        text = (
            f"The rotor answers mostly against the direction of the force, in "
            f"{'all runs' if everywhere else _list(runs)}. Check {cause}."
        )
        yield Finding("error", "wrong-direction", text, orbits.rows_of(np.flatnonzero(hit)))
    largest = max((part for key, part in share.items() if key not in bad), default=0.0)
    if largest > 0.02:
        text = (
            f"Up to {largest:.0%} of the response is against the direction of the force: anisotropy, or probes that "
            "differ. Compare with the model Anisotropic before trusting an isotropic one."
        )
        yield Finding("note", "anisotropy", text)


def _established(values: Float) -> float:
    """Sum over its standard deviation under random signs; noise cannot make it large, few values cannot either."""
    size = np.sqrt(np.sum(values**2))
    return float(np.sum(values) / size) if size > 0 else 0.0


def _signs(orbits: _Orbits) -> Iterator[Finding]:
    """Conjugated FRFs, or else a reversed sense of rotation, from the sign of Im kappa at drive points."""
    at = np.flatnonzero((orbits.plane == orbits.force_plane) & (np.abs(orbits.right) > 0))
    kappa = np.zeros(orbits.right.size, dtype=complex)
    kappa[at] = orbits.force[at] / orbits.right[at]
    drives = [group[np.isin(group, at)] for _, group in orbits.groups("run", "plane", "force_plane")]
    conjugated = [group for group in drives if _dissipates(orbits, kappa, group) < 0]
    if all(_dissipates(orbits, kappa, group) == 0 for group in drives):
        sweeps = [group[np.isin(group, at)] for _, group in orbits.groups("plane", "force_plane", "speed")]
        conjugated = [group for group in sweeps if _falls(orbits, kappa, group)]
    if not conjugated:
        yield from _reversed(orbits, kappa, at)
        return
    hit = np.concatenate(conjugated)
    text = (
        "Damping would be negative at the drive point (quadrature dynamic stiffness falls with frequency) in "
        f"{_list(_names(orbits, hit))}: the FRF is conjugated. Give phases of lag as phase_lag_deg and "
        "force_phase_lag_deg, or check the sign convention of the analyser."
    )
    yield Finding("error", "conjugated", text, orbits.rows_of(hit))


def _dissipates(orbits: _Orbits, kappa: ComplexArray, at: Index) -> int:
    """Sign of the dissipation at |w| >= Omega, where the force leads or opposes the fluid whatever lam < 1 is; 0:
    unknown."""
    w = orbits.frequency[at]
    fast = np.abs(w) >= np.abs(orbits.speed[at]) * (1 - NEAR_1X)
    if fast.sum() < ENOUGH:
        return 0
    sine = kappa[at].imag / np.abs(kappa[at]) * np.sign(w)
    # a phase of a few degrees may be an error of the reference: such readings hardly count
    score = _established((sine / np.hypot(sine, SMALL_SINE))[fast])
    return int(np.sign(score)) if abs(score) > CERTAIN else 0


def _falls(orbits: _Orbits, kappa: ComplexArray, at: Index) -> bool:
    """Whether quadrature falls from backward to forward in a sweep below the speed.

    One direction is enough if there is but one plane; else the other planes' motion turns the slope within a direction.
    """
    w = orbits.frequency[at]
    one_plane = np.unique(orbits.plane).size == 1
    return (one_plane or bool((w > 0).any() and (w < 0).any())) and _rank_correlation(w, kappa[at].imag) < -0.8


def _reversed(orbits: _Orbits, kappa: ComplexArray, at: Index) -> Iterator[Finding]:
    # slow unbalance moves the rotor little and noise turns its phase: weigh the sign by the response
    power = kappa.imag / np.maximum(np.abs(kappa), np.finfo(float).tiny) * np.abs(orbits.right)
    for _, group in orbits.groups("run", "plane", "force_plane"):
        power[group] /= np.abs(orbits.right[group]).max() or 1.0
    ratio = orbits.frequency[at] / np.where(orbits.speed[at] == 0, np.nan, np.abs(orbits.speed[at]))
    slow = [at[(ratio < 0) & (ratio > -limit)] for limit in (0.1, 0.2, 0.3, 0.5)]
    score, hit = max(((_established(power[some]), some) for some in slow), key=lambda pair: pair[0])
    if score > CERTAIN:
        text = (
            f"Slow backward forces drive the rotor instead of damping it in {_list(_names(orbits, hit))}: lam would be "
            "negative. The sense of rotation is reversed, or x and y are exchanged together with the sign of the "
            "frequency; x has to turn towards y with the rotor."
        )
        yield Finding("error", "reversed-rotation", text, orbits.rows_of(hit))


def _names(orbits: _Orbits, at: Index) -> list[str]:
    return list(dict.fromkeys(orbits.run[at].tolist()))


def _rank_correlation(x: Float, y: Float) -> float:
    if x.size < ENOUGH or np.ptp(x) == 0 or np.ptp(y) == 0:
        return 0.0
    ranks = [np.argsort(np.argsort(values)).astype(float) for values in (x, y)]
    return float(np.corrcoef(ranks[0], ranks[1])[0, 1])


def _peak_to_peak(orbits: _Orbits) -> Iterator[Finding]:
    """Ratios of two between readings that should agree: x and y, forward and backward at w -> 0, H_ab and H_ba."""
    for (plane,), at in orbits.groups("plane"):
        strong = at[np.isfinite(orbits.wrong[at])]
        strong = (
            strong[np.abs(orbits.right[strong]) >= np.median(np.abs(orbits.right[strong]))] if strong.size else strong
        )
        if _is_two(_log_ratio(orbits.x[strong], orbits.y[strong])):
            yield _twice(f"The x and y probes at {plane} differ by a factor of two", orbits, at)
    for (force_plane, plane, speed), at in orbits.groups("force_plane", "plane", "speed"):
        where = f"at {plane} under a force at {force_plane} ({float(speed) * 30 / np.pi:.6g} rpm)"
        if abs(abs(_jump_at_zero(orbits, at)) - 1) < 0.15:
            yield _twice(f"Forward and backward responses {where} differ by a factor of two near zero", orbits, at)
    pairs = {tuple(sorted(pair)) for pair, _ in orbits.groups("force_plane", "plane") if pair[0] != pair[1]}
    for a, b in sorted(pairs):
        there = _transfer(orbits, a, b)
        back = _transfer(orbits, b, a)
        common = sorted(set(there) & set(back))
        if _is_two(_log_ratio(np.array([there[k] for k in common]), np.array([back[k] for k in common]))):
            here = np.flatnonzero(np.isin(orbits.plane, (a, b)) & np.isin(orbits.force_plane, (a, b)))
            yield _twice(f"Reciprocal responses between {a} and {b} differ by a factor of two", orbits, here)


def _twice(what: str, orbits: _Orbits, at: Index) -> Finding:
    text = f"{what}: some amplitudes may be peak-to-peak. Name their unit (amplitude_um_pp) or correct them with gains."
    return Finding("warning", "peak-to-peak", text, orbits.rows_of(at))


def _log_ratio(a: NDArray[Any], b: NDArray[Any]) -> Float:
    some = (np.abs(a) > 0) & (np.abs(b) > 0)
    return np.asarray(np.log2(np.abs(a[some]) / np.abs(b[some])))


def _is_two(logs: Float) -> bool:
    """Whether ratios are two (or a half) throughout; anisotropy and noise spread them."""
    if logs.size < 8:
        return False
    low, middle, high = np.percentile(logs, [25, 50, 75])
    return bool(abs(abs(middle) - 1) < 0.12 and high - low < 0.3)


def _transfer(orbits: _Orbits, force_plane: str, plane: str) -> dict[tuple[float, float], complex]:
    at = np.flatnonzero((orbits.force_plane == force_plane) & (orbits.plane == plane))
    keys = zip(orbits.speed[at].tolist(), np.round(orbits.frequency[at], 6).tolist(), strict=True)
    return dict(zip(keys, (orbits.right[at] / orbits.force[at]).tolist(), strict=True))


def _jump_at_zero(orbits: _Orbits, at: Index) -> float:
    """log2 of |H(0+)| / |H(0-)|, zero unless it is well determined.

    H is smooth across w = 0, so the logarithm of forward over backward is odd in w: any constant in it is a jump.
    """
    slow = at[(np.abs(orbits.frequency[at]) < 0.5 * np.abs(orbits.speed[at])) & (np.abs(orbits.right[at]) > 0)]
    response = {float(w): i for w, i in zip(np.round(orbits.frequency[slow], 6), slow, strict=True)}
    both = [(response[w], response[-w]) for w in sorted(response) if w > 0 and -w in response]
    if len(both) < 8:
        return 0.0
    forward, backward = np.array(both).T
    h = orbits.right / orbits.force
    log = np.log2(np.abs(h[forward]) / np.abs(h[backward]))
    w = orbits.frequency[forward] / orbits.frequency[forward].max()
    weight = np.minimum(np.abs(orbits.right[forward]), np.abs(orbits.right[backward]))  # noise is even, signals are not
    design = np.column_stack([np.ones_like(w), w, w**3])
    scaled = design * weight[:, None]
    solution, *_ = np.linalg.lstsq(scaled, log * weight, rcond=None)
    residual = (log - design @ solution) * weight
    variance = float(residual @ residual) / (w.size - 3) * np.linalg.pinv(scaled.T @ scaled)[0, 0]
    return float(solution[0]) if np.sqrt(variance) < 0.15 else 0.0
