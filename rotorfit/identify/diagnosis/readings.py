"""Readings that are no measurement: not finite, copied, zero, cut off, or of a size that no rotor has."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from rotorfit.base.array_types import Float, Index
from rotorfit.base.digits import counted, significant
from rotorfit.estimators.blocks.row_keys import combined, rows_by, words
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.findings import NO_COPIES, Finding, listed, rows_of
from rotorfit.lab.data.rows import Experiment

_LAST_DIGIT = 1e-9  # relative difference of what is equal to the last digit
_CLIPPED_READINGS, _CLIPPED_IN_A_ROW = 4, 3
"""Readings of a channel at its largest value, and how many of them follow one another, from which it may be cut off."""
_ROUNDING_STEPS = 5.0  # steps of rounding by which readings beside a hole or a flat top differ from it
_AMPLITUDES_COMPARED = 20  # distinct amplitudes that show the step


def amplitudes(test: Experiment) -> Iterator[Finding]:
    """Amplitudes that are too large or too small to be true, which no fit notices: stiffnesses are scaled alike."""
    lever = 0.1  # lever of slopes, m: one of 0.25 rad is as impossible as a displacement of 25 mm
    size = np.abs(test.motion) * np.where(test.lateral, 1.0, lever)
    largest = float(size.max())
    # Displacements, m: beyond what shakers and machines do, though small rigs come to it in mil instead of um; larger
    # than any clearance in use; and the largest of a sweep that hardly shows
    impossible_displacement, suspect_displacement, smallest_displacement = 0.025, 5e-3, 1e-6
    if largest > suspect_displacement:
        text = (
            f"Amplitudes reach {significant(largest, 3)} m 0-peak; no rotor in a bearing or seal moves that far. Check "
            "the unit of the amplitude column (um, mil, m)."
        )
        severity: Literal["error", "warning"] = "error" if largest > impossible_displacement else "warning"
        yield Finding(severity, "large-amplitude", text, rows_of(size > suspect_displacement))
    # Of frequency response functions, under unit force, the size says nothing of the motion.
    elif 0 < largest < smallest_displacement and not (getattr(test, "force", np.zeros(1)) == 1.0).all():
        text = (
            f"The largest amplitude is {significant(largest, 3)} m 0-peak, little for a rotor and hardly more than "
            "probes resolve. Check the unit of the amplitude column (amplitude_um, amplitude_mm): a wrong one "
            "makes every mass, damping and stiffness wrong, and no fit can notice."
        )
        yield Finding("warning", "small-amplitude", text)


def copied_readings(test: Experiment) -> Iterator[Finding]:
    """Readings, and runs, that are there twice."""
    read = test.motion
    if not (np.diff(np.sort(read.real)) == 0).any():
        return
    number, count = np.unique(read, return_inverse=True, return_counts=True)[1:]
    some = np.flatnonzero(count[number] > 1)
    if not some.size:
        return
    columns = [getattr(test, name)[some].tolist() for name in test._columns() if name != "sigma"]
    first: dict[Any, int] = {}
    again = np.zeros(read.size, dtype=bool)
    again[some] = [first.setdefault(key, i) != i for i, key in enumerate(zip(*columns, strict=True))]
    if again.any():
        text = f"Copies: {counted(again.sum(), 'reading')} of an earlier row, to the last digit. {NO_COPIES}"
        yield Finding("warning", "duplicate", text, rows_of(again), remedy="leave the copies out")
    yield from copied_runs([test])[0]


def copied_runs(tests: Sequence[Experiment]) -> list[list[Finding]]:
    """Runs all of whose readings a run before it has, to the last digit, for each of several tests."""
    copies = copies_among([run_digests(test) for test in tests], [test.source for test in tests])
    return [
        [copies_finding(own, rows_of(np.isin(test.run, list(own))))] if own else []
        for test, own in zip(tests, copies, strict=True)
    ]


def copies_among(digests: Sequence[Mapping[str, bytes]], sources: Sequence[str]) -> list[dict[str, str]]:
    """Runs of each of several tests that are copies, and of which run of which test."""
    first: dict[bytes, tuple[int, str]] = {}
    found: list[dict[str, str]] = []
    for number, runs in enumerate(digests):
        found.append({})
        for run, digest in runs.items():
            of, original = first.setdefault(digest, (number, run))
            if (of, original) != (number, run):
                found[-1][run] = original if of == number else f"{original} of {sources[of] or f'test {of + 1}'}"
    return found


def copies_finding(copies: Mapping[str, str], rows: Sequence[int] = ()) -> Finding:
    """Sentences on runs that are copies of others."""
    pairs = listed([f"{run} repeats {original}" for run, original in copies.items()])
    text = f"Copies of runs, to the last digit: {pairs}. {NO_COPIES}"
    return Finding("warning", "duplicate", text, tuple(rows), remedy="leave the copies out")


def run_digests(experiment: Experiment) -> dict[str, bytes]:
    """Runs that hold some readings, and a hash of all that is known of those."""
    found: dict[str, bytes] = {}
    if (test := experiment.perturbation) is None:
        return found
    values = (test.speed, test.frequency, test.force, test.response)
    copied_readings = 3  # readings of a run that agree to the last digit from which that is no chance
    for some in rows_by(test.category("run").number):
        if some.size >= copied_readings and test.response[some].any():
            numbers = np.stack([part for column in values for part in (column[some].real, column[some].imag)])
            sequence = np.lexsort(numbers)
            rows = some[sequence]
            digest = hashlib.sha256(numbers[:, sequence].tobytes())
            for key in ("force_plane", "plane", "direction"):
                names, place = words(getattr(test, key)[rows])
                digest.update("\0".join([*names, ""]).encode("utf-8") + place.tobytes())
            found[str(test.run[some[0]])] = digest.digest()
    return found


def unread(test: PerturbationTest) -> Iterator[Finding]:
    """Zeros where the readings beside are far from it, and probes that read nothing but zero."""
    zero = test.response == 0
    if not zero.any():
        return
    channel, size = test.alike("plane", "direction")[1], np.abs(test.response)
    dead = np.bincount(channel, size) == 0
    alone = dead[channel] & ~test.linear
    if alone.any() and not dead.all():
        text = f"Nothing but zero was read by the probe {_probes(test, np.flatnonzero(alone))}. Remove its rows."
        yield Finding("error", "dead-probe", text, rows_of(alone), remedy="remove its rows")
    holes: list[int] = []
    steps = _steps(channel, size, slice(_AMPLITUDES_COMPARED))
    for sweep in _sweeps(test, channel):
        read, empty = np.flatnonzero(~zero[sweep]), np.flatnonzero(zero[sweep])
        if not read.size:
            continue
        # Where readings beside do not turn through zero, as at an antiresonance.
        after = np.searchsorted(read, empty)
        before, behind = (test.response[sweep[read[np.clip(at, 0, read.size - 1)]]] for at in (after - 1, after))
        step = steps[int(channel[sweep[0]])]
        holes += sweep[empty[np.abs(before + behind) / 2 > _ROUNDING_STEPS * step]].tolist()
    if holes:
        text = (
            f"Zero: {counted(len(holes), 'reading')} exactly zero beside others that are not: cells that were empty, "
            "or lines that were not measured. Remove these rows."
        )
        yield Finding("error", "zero", text, tuple(sorted(holes)), remedy="remove these rows")


def clipped(test: PerturbationTest) -> Iterator[Finding]:
    """Amplitudes that stay at the largest value of their probe, to the last digit, over several lines."""
    channel, size = test.alike("plane", "direction")[1], np.abs(test.response)
    top = np.zeros(int(channel.max(initial=0)) + 1)
    np.maximum.at(top, channel, size)
    flat = (size >= top[channel] * (1 - _LAST_DIGIT)) & (size > 0)
    if np.bincount(channel[flat]).max(initial=0) < _CLIPPED_READINGS:
        return
    steps = _steps(channel, size, slice(-_AMPLITUDES_COMPARED, None))
    ends = set()  # channels of which several readings in a row are at the largest, and those beside fall steeply
    for sweep in _sweeps(test, channel):
        step = steps[int(channel[sweep[0]])]
        edges = np.flatnonzero(np.diff(np.concatenate([[False], flat[sweep], [False]]).astype(np.int8)))
        for begin, end in edges.reshape(-1, 2).tolist():
            beside = [size[sweep[at]] for at in (begin - 1, end) if 0 <= at < sweep.size]
            in_a_row = end - begin >= _CLIPPED_IN_A_ROW and bool(beside)
            if in_a_row and size[sweep[begin]] - min(beside) > _ROUNDING_STEPS * step:
                ends.add(int(channel[sweep[0]]))
    cut = np.flatnonzero(flat & np.isin(channel, list(ends)))
    if cut.size:
        text = (
            f"Cut off: {cut.size} readings of {_probes(test, cut)} have the largest amplitude of their probe to the "
            f"last digit, {significant(size[cut].max(), 4)} m, line after line, as where a probe or an amplifier is at "
            "the end of its range. Remove these rows."
        )
        yield Finding("error", "clipped", text, tuple(cut.tolist()), remedy="remove these rows")


def _probes(test: PerturbationTest, rows: Index) -> str:
    return ", ".join(dict.fromkeys(f"{test.direction[row]} at {test.plane[row]}" for row in rows.tolist()))


def _sweeps(test: PerturbationTest, channel: Index) -> list[Index]:
    """Rows of one probe in one run and under one force's plane, in the order of frequency."""
    return rows_by(combined(test.alike("run", "force_plane")[1], channel), test.frequency)


def _steps(channel: Index, size: Float, some: slice) -> dict[int, float]:
    """Step to which some amplitudes of like size of each channel are rounded: files hold so many digits, or so many
    significant ones."""
    found = {}
    for one in np.unique(channel).tolist():
        distinct = np.unique(size[(channel == one) & (size > 0)])[some]
        steps = np.diff(distinct)
        found[one] = float(steps[steps > _LAST_DIGIT * distinct[1:]].min(initial=np.inf))
    return {one: step if step < np.inf else 0.0 for one, step in found.items()}
