"""Slips in what a file tells besides its readings: forces, speeds, planes, angles and units told as something else.

An unbalance told as a constant force, or two speeds exchanged, leave responses like those of a rotor, only of another
one: nothing in the signs and sizes of the readings is odd.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, islice

import numpy as np

from rotorfit.data.experiments import Experiment, PerturbationTest
from rotorfit.fitting.problem_setup import build_problem
from rotorfit.fitting.settings import FitSettings
from rotorfit.fitting.slips.readings import Found, Trial
from rotorfit.models import RotorModel
from rotorfit.models.array_types import ComplexArray, Float, Index
from rotorfit.units import RPM_PER_RAD_S

_CONSTANT = 0.01  # relative spread of what is taken as constant
_MOST_PAIRS = 3
_TURN = 6.3  # degrees: what a whole turn in radians is, read as degrees

_MOST_RUNS = 12  # pairs of runs
_LEVELS = 20.0, 100.0, 200.0  # dB between the largest and the smallest level, at least and most; the largest at most
_ONLY_A_PEAK = 0.03
"""Misfit that is left, of that of the data as told, if they are levels: undone, hardly more than one peak is left of
any data, which many models explain somewhat better."""
_DECIBELS = {"um": 1e-6, "mil": 25.4e-6, "mm": 1e-3}

_MOUNTINGS = (45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0)
_PLANES = {"plane": "readings", "force_plane": "forces"}
_SPEED_UNITS = {
    "the speeds are in Hz and read as rpm (speed_hz)": 60.0,
    "the speeds are in rpm and read as Hz (speed_rpm)": 1 / 60,
    "the speeds are in rad/s and read as rpm (speed_rad_s)": RPM_PER_RAD_S,
    "the speeds are in rpm and read as rad/s (speed_rpm)": 1 / RPM_PER_RAD_S,
}


@dataclass(frozen=True, kw_only=True)
class _Slip:
    """One slip: what is wrong and what to do, how a test is without it, whether a datum is to be fitted, and the share
    of the misfit that it may leave at the most."""

    told: str
    mend: Callable[[PerturbationTest], PerturbationTest]
    datum: bool = False
    least: float = 1.0


def label_slips(
    model: RotorModel, experiments: Sequence[Experiment], settings: FitSettings, trial: Trial, missed: float
) -> Iterator[Found]:
    """What fits leave with each slip undone, one after the other."""
    for tried in _slips([test for test in experiments if isinstance(test, PerturbationTest)]):
        if tried.datum and settings.phase_offsets:
            continue
        mended = [tried.mend(test) if isinstance(test, PerturbationTest) else test for test in experiments]
        changed = replace(settings, phase_offsets="common") if tried.datum else settings
        try:
            problem = build_problem(model, mended, changed)
        except (ValueError, np.linalg.LinAlgError):  # what cannot be fitted explains nothing
            continue
        left = trial(problem)[0] / missed
        if left < tried.least:
            yield Found(left=left, told=tried.told)


def _slips(tests: Sequence[PerturbationTest]) -> Iterator[_Slip]:
    """Every slip that these data may have."""
    if not tests or any(test.linear.any() or not (test.force.all() and test.frequency.all()) for test in tests):
        return
    if all(_is_constant(test, np.abs(test.force)) for test in tests):
        told = (
            "the forces are those of an unbalance, which grow with the square of the frequency, and are told as "
            "constant. Give the unbalance (mr_g_mm) in place of force_N"
        )
        yield _Slip(told=told, mend=lambda test: replace(test, force=test.force * test.frequency**2))
    if all(_is_constant(test, np.abs(test.force) / test.frequency**2) for test in tests):
        told = "the forces are constant, and are told as those of an unbalance. Give force_N in place of mr_g_mm"
        yield _Slip(told=told, mend=lambda test: replace(test, force=test.force / test.frequency**2))
    yield from _exchanges(tests)
    yield from _exchanged_runs(tests)
    for unit, size in _DECIBELS.items():
        if all(_may_be_decibels(np.abs(test.response) / size) for test in tests):
            told = f"the amplitudes are in dB and read as {unit}. Give them in the unit that 0 dB stands for"
            yield _Slip(told=told, mend=partial(_from_decibels, unit=size), least=_ONLY_A_PEAK)
    told = (
        "all forces are one angle off against all readings, as where weight holes, Keyphasor and probes have no common "
        "zero. Give the angle, or fit it (phase_offsets common)"
    )
    for degrees in (*_MOUNTINGS, 0.0):  # near one of which the search finds the angle
        yield _Slip(told=told, mend=partial(_other_zero, degrees=degrees), datum=True)
    for degrees in _MOUNTINGS:
        told = f"all probes sit {degrees:g} degrees from where they are told to be, counted from x towards y"
        yield _Slip(told=told, mend=partial(_turned_back, degrees=degrees))
    for told, factor in () if any(test.synchronous for test in tests) else _SPEED_UNITS.items():
        yield _Slip(told=told, mend=partial(_times, factor=factor))
    if all(_are_radians(test.force) for test in tests):
        told = "the phases of the forces are in radians and read as degrees (force_phase_deg)"
        yield _Slip(told=told, mend=lambda test: replace(test, force=_as_radians(test.force)))
    if all(_are_radians(test.response) and not np.char.endswith(test.direction, "z").any() for test in tests):
        told = "the phases of the readings are in radians and read as degrees (phase_deg)"
        yield _Slip(told=told, mend=lambda test: replace(test, response=_as_radians(test.response)))


def _exchanges(tests: Sequence[PerturbationTest]) -> Iterator[_Slip]:
    """Two speeds, or two planes, under each other's names."""
    for column in ("speed", "plane", "force_plane"):
        if column == "speed" and any(test.synchronous for test in tests):
            continue  # there the speed is the frequency
        values = np.unique(np.concatenate([getattr(test, column) for test in tests])).tolist()
        for a, b in islice(combinations(values, 2), _MOST_PAIRS):
            told = f"the planes {a} and {b} of the {_PLANES.get(column)} are exchanged"
            if column == "speed":
                told = f"the speeds {a * RPM_PER_RAD_S:.6g} and {b * RPM_PER_RAD_S:.6g} rpm are exchanged"
            yield _Slip(told=told, mend=partial(_exchanged, column=column, a=a, b=b))


def _exchanged_runs(tests: Sequence[PerturbationTest]) -> Iterator[_Slip]:
    """Two runs with the same readings in their plan, under each other's names."""
    places = {(number, run): _places(test, run) for number, test in enumerate(tests) for run in test.runs}
    alike = (
        (number, a, b, own, other)
        for ((number, a), own), ((also, b), other) in combinations(places.items(), 2)
        if number == also and own.size == other.size and _is_one_plan(tests[number], own, other)
    )
    for number, a, b, own, other in islice(alike, _MOST_RUNS):
        told = f"the readings of the runs {a} and {b} are exchanged"
        yield _Slip(told=told, mend=partial(_with_readings_of, mended=tests[number], rows=own, others=other))


def _places(test: PerturbationTest, run: str) -> Index:
    """Rows of a run by plane, direction and frequency."""
    rows = np.flatnonzero(test.run == run)
    return rows[np.lexsort([test.frequency[rows], test.direction[rows], test.plane[rows]])]


def _is_one_plan(test: PerturbationTest, own: Index, other: Index) -> bool:
    return all(
        (getattr(test, name)[own] == getattr(test, name)[other]).all() for name in ("plane", "direction")
    ) and bool(np.allclose(test.frequency[own], test.frequency[other], rtol=1e-3, atol=0.0))


def _with_readings_of(
    test: PerturbationTest, *, mended: PerturbationTest, rows: Index, others: Index
) -> PerturbationTest:
    if test is not mended:
        return test
    response, sigma = test.response.copy(), test.sigma.copy()
    for values in (response, sigma):
        values[rows], values[others] = values[others], values[rows]
    return replace(test, response=response, sigma=sigma)


def _may_be_decibels(told: Float) -> bool:
    """Whether amplitudes are numbers that levels in dB could be, of a rotor with a resonance."""
    least, most, largest = _LEVELS
    return bool(told.max() < largest and least < np.ptp(told) < most)


def _from_decibels(test: PerturbationTest, *, unit: float) -> PerturbationTest:
    size = np.abs(test.response)
    level = (size - size.max()) / unit
    return replace(test, response=size.max() * 10 ** (level / 20) * np.exp(1j * np.angle(test.response)))


def _turned_back(test: PerturbationTest, *, degrees: float) -> PerturbationTest:
    """Readings as probes in their place would have them, as far as orbits are circular."""
    sense = np.where(np.char.endswith(test.direction, "z") | (test.frequency > 0), 1.0, -1.0)
    return replace(test, response=test.response * np.exp(1j * np.radians(degrees) * sense))


def _other_zero(test: PerturbationTest, *, degrees: float) -> PerturbationTest:
    return replace(test, force=test.force * np.exp(1j * np.radians(degrees)))


def _times(test: PerturbationTest, *, factor: float) -> PerturbationTest:
    return replace(test, speed=test.speed * factor)


def _exchanged(test: PerturbationTest, *, column: str, a: object, b: object) -> PerturbationTest:
    values = getattr(test, column)
    changed = values.copy()
    changed[values == a], changed[values == b] = b, a
    return replace(test, **{column: changed})


def _is_constant(test: PerturbationTest, size: Float) -> bool:
    """Whether something is the same all through each run."""
    for run in test.runs:
        own = size[test.run == run]
        if np.ptp(own) > _CONSTANT * own.max():
            return False
    swept = np.abs(test.frequency)
    return bool(np.ptp(swept) > _CONSTANT * swept.max())


def _are_radians(values: ComplexArray) -> bool:
    """Whether all phases, read as degrees, lie within what a turn is in radians, and are not simply zero."""
    degrees = np.abs(np.degrees(np.angle(values)))
    return bool(degrees.max() <= _TURN and degrees.max() > 0)


def _as_radians(values: ComplexArray) -> ComplexArray:
    return np.asarray(np.abs(values) * np.exp(1j * np.degrees(np.angle(values))))
