"""The table of errors in what a file gives besides its readings: each with a code, a sentence and how it is undone.

An unbalance read as a constant force, or two speeds exchanged, leave responses like those of a rotor, only of another
one: nothing in the signs and sizes of the readings is odd. Each is scored alike: by the misfit of a trial fit with the
error undone (:mod:`rotorfit.identify.diagnosis.findings`). A new error of this kind is one more entry here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, islice
from typing import Any

import numpy as np

from rotorfit.base.array_types import Float, Index
from rotorfit.base.names import unknown_name
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.identify.diagnosis.check import SHOWN_BY_TESTS, check, mended
from rotorfit.identify.diagnosis.orbits import Orbits, orbits_of_tests, total_power
from rotorfit.identify.diagnosis.probe_filters import FilteredProbe
from rotorfit.identify.diagnosis.probe_pairs import uneven_planes
from rotorfit.identify.diagnosis.trial_fits import MOST_PLANES, Explanation, corrected_by_value
from rotorfit.lab.data.experiments import PerturbationTest, perturbations
from rotorfit.lab.data.findings import listed
from rotorfit.lab.data.rows import Experiment

_DECIBELS = {"um": 1e-6, "mil": 25.4e-6, "mm": 1e-3}

PHASE_ZEROS = "phase-zeros-differ"
"""Code of the error that a fit undoes itself, by one angle between forces and readings."""
_PLANES = {"plane": "readings", "force_plane": "forces"}
_SPEED_UNITS = {("Hz", "rpm"): 60.0, ("rpm", "Hz"): 1 / 60, ("rad/s", "rpm"): RPM_PER_RAD_S}
_SPEED_UNITS[("rpm", "rad/s")] = 1 / RPM_PER_RAD_S
_COLUMNS = {"Hz": "speed_hz", "rpm": "speed_rpm", "rad/s": "speed_rad_s"}

_FORCE_LAWS = {
    (0, 2): (
        "unbalance-as-constant",
        "the forces are those of an unbalance, which grow with the square of the frequency, and are given as constant",
        'give the unbalance (mr_g_mm) in place of force_N (numbers in g mm: columns = {force_N = "mr_g_mm"}, '
        "--column force_N=mr_g_mm)",
    ),
    (2, 0): (
        "constant-as-unbalance",
        "the forces are constant, and are given as those of an unbalance",
        'give force_N in place of mr_g_mm (numbers in N: columns = {mr_g_mm = "force_N"}, --column mr_g_mm=force_N)',
    ),
}
"""By powers of the frequency that forces grow with, as given and in truth: code, what is wrong, how it is undone."""

_PAIRS = {
    "exchanged": (True, (1.0, 1.0)),
    "inverted in y": (False, (1.0, -1.0)),
    "inverted in x": (False, (-1.0, 1.0)),
    "exchanged and both inverted": (True, (-1.0, -1.0)),
}
"""How a pair of probes mirrors orbits: whether directions are under each other's names, and signs of x and y."""

_CABLES = " (between x and y, at 45 and 135 degrees, their cables may be exchanged)"

Correction = Callable[[PerturbationTest], PerturbationTest]


@dataclass(frozen=True, kw_only=True)
class DataError:
    """One error that data may have."""

    code: str
    message: str  # what is wrong
    undo: str  # what a user does about it
    correct: Correction  # the test without it
    of: str = ""  # which of several errors of this code
    frees_datum: bool = False  # whether a common zero of phases is fitted then
    leaves_scale_open: bool = False  # whether the numbers that were given do not say how large the right ones are
    leaves_at_most: float = 1.0  # share of the misfit

    @property
    def name(self) -> str:
        """Name that distinguishes it from all others that the same data may have: ``probes-turned (journal by 45)``."""
        return f"{self.code} ({self.of})" if self.of else self.code

    @property
    def can_be_undone(self) -> bool:
        """True if the data as given say all that the right ones need."""
        return not (self.frees_datum or self.leaves_scale_open)

    def explains(self, left: float, end: Float | None = None) -> Explanation:
        """The error as an explanation of the misfit but for a share that is left by a trial fit, and its end."""
        name = self.name if self.can_be_undone else None
        return Explanation(left=left, code=self.code, message=self.message, undo=self.undo, correction=name, end=end)


def filtered_probes(uneven: Mapping[str, FilteredProbe | None]) -> Iterator[DataError]:
    """One probe of a pair behind a filter, as the ratio of the two shows."""
    for plane, one in uneven.items():
        if one is not None:
            what, undo = one.words
            yield DataError(
                code="probe-filter",
                of=f"{plane} {one.probe}",
                message=f"the readings of the {one.probe} probe at {plane} are {what}",
                undo=undo,
                correct=partial(_unfiltered, plane=plane, probe=one),
            )


def backward_angles(tests: Sequence[PerturbationTest]) -> Iterator[DataError]:
    """Angles of backward forces given as phases: twice the angle, of which D and lam take up the most."""
    least_sine = 0.02  # of the angle of a force, about a degree, from which the sense of counting matters
    if any(((test.frequency < 0) & (np.abs(np.sin(np.angle(test.force))) > least_sine)).any() for test in tests):
        yield DataError(
            code="backward-angles",
            message="the angles of backward forces are those of a protractor, from x towards y, and are given as "
            "phases, which count along the turning of the force",
            undo="give force_angle_deg in place of force_phase_deg",
            correct=lambda test: test.with_forces(lambda force: np.where(test.frequency < 0, force.conj(), force)),
        )


def mirrored_orbits(orbits: Sequence[Orbits]) -> Iterator[DataError]:
    """Pairs of probes, or phases, that make orbits turn the wrong way round; such motion a fit does not see at all.
    They do so in all runs, or in some alone, whose cables were exchanged or whose force turned the other way."""
    power: dict[tuple[str, str], list[float]] = {}
    for one in orbits:
        for key, at in one.groups("plane", "run"):
            some = at[one.paired[at]]
            if some.size:
                power[key] = [total_power(part[some]) for part in (one.right, one.wrong)]
    against = {key: wrong > right for key, (right, wrong) in power.items()}
    planes = dict.fromkeys(plane for plane, _ in against)
    by_runs: dict[tuple[str, ...], list[str]] = {}  # planes by the runs in which they are against; all runs: none named
    for plane in planes:
        own = {run: wrong for (at, run), wrong in against.items() if at == plane}
        right, wrong = (sum(power[plane, run][k] for run in own) for k in (0, 1))
        runs = () if all(own.values()) else tuple(run for run, other in own.items() if other)
        for named in dict.fromkeys([runs, *([()] if wrong > right else [])]):  # all: where a few weak lines go right
            if named or wrong > right:
                by_runs.setdefault(named, []).append(plane)
    for runs, some_planes in by_runs.items():
        yield from _mirrored(some_planes, runs, len(some_planes) == len(planes))


def _mirrored(planes: Sequence[str], runs: tuple[str, ...], everywhere: bool) -> Iterator[DataError]:
    """Why orbits at some planes, in all runs or in some of them, turn the wrong way round."""
    there = f" in {' and '.join(runs)}" if runs else ""  # of a name, which has no commas
    said = f" in {listed(runs)}" if runs else ""
    whole = partial(_in_runs, runs=runs)
    if everywhere or not runs:
        yield DataError(
            code="lag-as-lead",
            of=there.removeprefix(" "),
            message=f"phases of lag are given as lead{said}",
            undo="give phase_lag_deg and force_phase_lag_deg in place of phase_deg and force_phase_deg",
            correct=partial(whole, correct=_conjugated),
        )
    if everywhere and runs:
        yield DataError(
            code="whirl-reversed",
            of=there.removeprefix(" "),
            message=f"the force turns the other way than its sign of frequency says{said}",
            undo="give the frequencies of these runs the other sign",
            correct=partial(whole, correct=lambda test: replace(test, frequency=-test.frequency)),
        )
    where = " and ".join(planes)
    for what, (swapped, signs) in _PAIRS.items():
        yield DataError(
            code=f"probes-{'exchanged' if swapped else 'inverted'}",
            of=f"{what} at {where}{there}",
            message=f"the probes at {where} are {what}{said}{'' if swapped else _CABLES}",
            undo="give the readings of x and y at these planes the right names and signs",
            correct=partial(whole, correct=partial(_paired_anew, planes=planes, swapped=swapped, signs=signs)),
        )


def data_errors(tests: Sequence[PerturbationTest]) -> Iterator[DataError]:
    """Every error that these data may have."""
    if not tests or any(
        test.linear.any() or test.several.any() or not (test.force.all() and test.frequency.all()) for test in tests
    ):
        return
    for (given, right), (code, message, undo) in _FORCE_LAWS.items():
        if all(_is_constant(test, np.abs(test.force) / test.frequency**given) for test in tests):
            yield DataError(
                code=code,
                message=message,
                undo=undo,
                correct=partial(_with_forces_times, power=right - given),
                leaves_scale_open=True,
            )
    yield from _exchanges(tests)
    yield from _exchanged_runs(tests)
    # Misfit that is left, of that of the data as given, if they are levels: undone, hardly more than one peak is left
    # of any data, which many models explain somewhat better
    misfit_of_levels = 0.03
    for unit, size in _DECIBELS.items():
        levels = [np.abs(test.response) / size for test in tests]
        # numbers that levels in dB could be, of a rotor with a resonance: the largest, and from it to the smallest
        if all(level.max() < 200.0 and 20.0 < np.ptp(level) < 100.0 for level in levels):
            yield DataError(
                code="levels-in-decibels",
                of=unit,
                message=f"the amplitudes are in dB and read as {unit}",
                undo="give them in the unit that 0 dB stands for, 10^(L/20) times it "
                f"(--undo 'levels-in-decibels ({unit}: 1)' where 0 dB is 1 {unit})",
                correct=partial(_from_decibels, unit=size),
                leaves_at_most=misfit_of_levels,
                leaves_scale_open=True,
            )
    mounting_angles = (45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0)
    for degrees in (*mounting_angles, 0.0):  # near one of which the search finds the angle
        yield DataError(
            code=PHASE_ZEROS,
            message="all forces are one angle off against all readings, as where weight holes, Keyphasor and probes "
            "have no common zero",
            undo='give the angle, or fit it (phase_offsets = "common", --phase-offsets common)',
            correct=partial(_with_forces_times, factor=np.exp(1j * np.radians(degrees))),
            frees_datum=True,
        )
    planes = np.unique(np.concatenate([test.plane for test in tests])).tolist()
    for some in (planes, *([plane] for plane in planes[:MOST_PLANES] if len(planes) > 1)):
        for degrees in mounting_angles:
            who = "all probes" if some == planes else f"the probes at {some[0]}"
            yield DataError(
                code="probes-turned",
                of=f"{'all' if some == planes else some[0]} by {degrees:g}",
                message=f"{who} sit {degrees:g} degrees from where they are given, counted from x towards y",
                undo=f"give their angles (probe_angles=, --probe-angles: {degrees:g} and {degrees + 90:g})",
                correct=partial(_turned_back, planes=some, degrees=degrees),
            )
    for (true, read), factor in () if any(test.synchronous for test in tests) else _SPEED_UNITS.items():
        yield DataError(
            code="speed-unit",
            of=f"{true} read as {read}",
            message=f"the speeds are in {true} and read as {read}",
            undo=f"name their unit ({_COLUMNS[true]})",
            correct=partial(_with_speeds, factor=factor),
        )
    turn_in_radians = 6.3  # degrees: what a whole turn in radians is, read as degrees
    for column, whose in (("force", "forces"), ("response", "readings")):
        phases = [np.abs(np.degrees(np.angle(getattr(test, column)))).max() for test in tests]
        is_z = column == "response" and any(np.char.endswith(test.direction, "z").any() for test in tests)
        if all(0 < largest <= turn_in_radians for largest in phases) and not is_z:
            yield DataError(
                code="phases-in-radians",
                of=whose,
                message=f"the phases of the {whose} are in radians and read as degrees",
                undo=f"give {'force_phase_deg' if column == 'force' else 'phase_deg'} in degrees",
                correct=partial(_from_radians, column=column),
            )


# ---- entries of several kinds ------------------------------------------------------------------------------------


def _exchanges(tests: Sequence[PerturbationTest]) -> Iterator[DataError]:
    """Two speeds, or two planes, under each other's names."""
    for column in ("speed", "plane", "force_plane"):
        if column == "speed" and any(test.synchronous for test in tests):
            continue  # there the speed is the frequency
        values = np.unique(np.concatenate([getattr(test, column) for test in tests])).tolist()
        for a, b in islice(combinations(values, 2), 3):
            if column == "speed":
                which = f"{a * RPM_PER_RAD_S:.6g} and {b * RPM_PER_RAD_S:.6g} rpm"
                code, of, what = "speeds-exchanged", which, f"speeds {which}"
            else:
                which = f"{a} and {b}"
                code, of, what = "planes-exchanged", f"{column} {which}", f"planes {which} of the {_PLANES[column]}"
            yield DataError(
                code=code,
                of=of,
                message=f"the {what} are exchanged",
                undo=f"exchange them in the column {column}",
                correct=partial(_exchanged, column=column, a=a, b=b),
            )


def _exchanged_runs(tests: Sequence[PerturbationTest]) -> Iterator[DataError]:
    """Two runs with the same readings in their plan, under each other's names."""

    def pairs() -> Iterator[tuple[PerturbationTest, str, str, Index, Index]]:
        for test in tests:
            places = {}  # rows of each run by plane, direction and frequency
            for run in test.runs:
                rows = np.flatnonzero(test.run == run)
                places[run] = rows[np.lexsort([test.frequency[rows], test.direction[rows], test.plane[rows]])]
            for (a, own), (b, other) in combinations(places.items(), 2):
                if own.size != other.size or any((c[own] != c[other]).any() for c in (test.plane, test.direction)):
                    continue
                if np.allclose(test.frequency[own], test.frequency[other], rtol=1e-3, atol=0.0):
                    yield test, a, b, own, other

    for test, a, b, own, other in islice(pairs(), 12):
        yield DataError(
            code="runs-exchanged",
            of=f"{a} and {b}",
            message=f"the readings of the runs {a} and {b} are exchanged",
            undo="exchange the names of the two runs",
            correct=partial(_with_readings_of, wrong=test, rows=own, others=other),
        )


# ---- corrections -------------------------------------------------------------------------------------------------


def _in_runs(test: PerturbationTest, *, runs: Collection[str], correct: Correction) -> PerturbationTest:
    """A correction of some runs alone, of all where none are named."""
    if not runs:
        return correct(test)
    other, own = correct(test), np.isin(test.run, tuple(runs))
    columns = ("frequency", "force", "further_forces", "response", "direction")
    changed = {name: np.where(own, getattr(other, name), getattr(test, name)) for name in columns}
    return replace(test, **changed)


def _conjugated(test: PerturbationTest) -> PerturbationTest:
    return replace(test.with_forces(np.conj), response=test.response.conj())


def _unfiltered(test: PerturbationTest, *, plane: str, probe: FilteredProbe) -> PerturbationTest:
    rows = (test.plane == plane) & (test.direction == probe.probe)
    seen = np.where(rows, probe.seen(1j * np.abs(test.frequency)), 1.0)
    return replace(test, response=test.response / seen, sigma=test.sigma / np.abs(seen))


def _paired_anew(
    test: PerturbationTest, *, planes: Sequence[str], swapped: bool, signs: tuple[float, float]
) -> PerturbationTest:
    response, direction = test.response.copy(), test.direction.copy()
    for axis, other, sign in (("x", "y", signs[0]), ("y", "x", signs[1])):
        rows = np.isin(test.plane, planes) & np.char.endswith(test.direction, axis)
        response[rows] *= sign
        if swapped:
            direction[rows] = np.char.replace(test.direction[rows], axis, other)
    return replace(test, response=response, direction=direction)


def _with_readings_of(
    test: PerturbationTest, *, wrong: PerturbationTest, rows: Index, others: Index
) -> PerturbationTest:
    if test is not wrong:
        return test
    response, sigma = test.response.copy(), test.sigma.copy()
    for values in (response, sigma):
        values[rows], values[others] = values[others], values[rows]
    return replace(test, response=response, sigma=sigma)


def _with_forces_times(test: PerturbationTest, *, factor: complex = 1.0, power: int = 0) -> PerturbationTest:
    return test.with_forces(lambda force: force * factor * test.frequency**power)


def _with_speeds(test: PerturbationTest, *, factor: float) -> PerturbationTest:
    return replace(test, speed=test.speed * factor)


def _from_decibels(test: PerturbationTest, *, unit: float, zero: float | None = None) -> PerturbationTest:
    """Amplitudes of levels, with what 0 dB is, m, or so that the largest keeps its number."""
    size = np.abs(test.response)
    least = size.max() * 10 ** (-size.max() / unit / 20) if zero is None else zero
    return replace(test, response=least * 10 ** (size / unit / 20) * np.exp(1j * np.angle(test.response)))


_LEVELS = re.compile(r"levels-in-decibels \((?P<unit>\w+): (?P<zero>\d+(?:\.\d*)?(?:e[-+]?\d{1,2})?)\)")
"""Name of a correction that says what 0 dB is, ``levels-in-decibels (um: 1)``."""


def _turned_back(test: PerturbationTest, *, planes: Sequence[str], degrees: float) -> PerturbationTest:
    """Readings as probes in their place would have them, as far as orbits are circular."""
    sense = np.where(np.char.endswith(test.direction, "z") | (test.frequency > 0), 1.0, -1.0)
    turn = np.exp(1j * np.radians(degrees) * sense)
    return replace(test, response=np.where(np.isin(test.plane, planes), turn, 1.0) * test.response)


def _exchanged(test: PerturbationTest, *, column: str, a: Any, b: Any) -> PerturbationTest:
    values = getattr(test, column)
    return replace(test, **{column: np.where(values == a, b, np.where(values == b, a, values))})


def _from_radians(test: PerturbationTest, *, column: str) -> PerturbationTest:
    values = getattr(test, column)
    return replace(test, **{column: np.abs(values) * np.exp(1j * np.degrees(np.angle(values)))})


def _is_constant(test: PerturbationTest, size: Float) -> bool:
    """True if something is the same all through each run."""
    constant_spread = 0.01  # relative spread of what is taken as constant
    for run in test.runs:
        own = size[test.run == run]
        if np.ptp(own) > constant_spread * own.max():
            return False
    swept = np.abs(test.frequency)
    return bool(np.ptp(swept) > constant_spread * swept.max())


def undone(experiments: Sequence[Experiment], names: Sequence[str]) -> tuple[Experiment, ...]:
    """The data with errors undone one after the other."""
    corrected = list(experiments)
    for name in names:
        shown = [[found for found in check(test) if found.correction == name] for test in corrected]
        if name in SHOWN_BY_TESTS and any(shown):
            corrected = [mended(test, found) for test, found in zip(corrected, shown, strict=True)]
            continue
        tests = perturbations(corrected)
        if (by_value := corrected_by_value(tests, name)) is not None:
            corrected = [test.corrected(by_value) for test in corrected]
            continue
        if (said := _LEVELS.fullmatch(name)) is not None and said["unit"] in _DECIBELS:
            unit = _DECIBELS[said["unit"]]
            levels = partial(_from_decibels, unit=unit, zero=float(said["zero"]) * unit)
            corrected = [test.corrected(levels) for test in corrected]
            continue
        orbits = orbits_of_tests(tests)
        beside = (*backward_angles(tests), *data_errors(tests))
        possible = (*mirrored_orbits(orbits), *filtered_probes(uneven_planes(orbits)), *beside)
        known = {error.name: error for error in possible if error.can_be_undone}
        if name not in known:
            seen = [found.correction for test in corrected for found in check(test) if found.correction]
            raise ValueError(f"undo: {unknown_name('error of these data', name, [*dict.fromkeys(seen), *known])}")
        corrected = [test.corrected(known[name].correct) for test in corrected]
    return tuple(corrected)
