"""From recordings to the experiment that a fit takes: responses with their noise, at lines chosen for the fit.

Sweeps of a perturbator are reduced one by one. Start-ups and shutdowns with the weight in one plane are reduced
together: what the weight does is found apart from residual unbalance, bow and run-out, which all of them share. The
method is in :mod:`rotorfit.estimators.signals.local_response`.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial

import numpy as np

from rotorfit.base.executors import carry_out
from rotorfit.base.units import RPM_PER_RAD_S
from rotorfit.lab.data.casing import with_casing
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.findings import PHASE_DATUM, Finding, listed, told_once, warn_of
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.selection import Wanted, selected
from rotorfit.lab.data.stator import without_stator
from rotorfit.lab.data.synchronous import join
from rotorfit.lab.data.weights import difference_unless_solved
from rotorfit.lab.recordings.quality import copied_recordings, probe_findings, spoiled
from rotorfit.lab.recordings.recording import Recording, named_apart
from rotorfit.lab.recordings.reduction.reductions import dwelling, force_of, reduced_responses
from rotorfit.lab.recordings.reduction.response_lines import Report
from rotorfit.lab.recordings.reduction.ring_downs import ring_downs
from rotorfit.lab.recordings.reduction.shaken_states import states
from rotorfit.lab.recordings.reduction.static_positions import static_positions
from rotorfit.lab.recordings.rig.setup import Force
from rotorfit.lab.recordings.signals import source_of

_LOG = logging.getLogger(__name__)
_Job = tuple[tuple[Recording, ...], int]
"""Recordings that are reduced together: one of a perturbator or a measured force, or start-ups with one weight; and the
number of groups of start-ups that the runs without a weight are part of."""


def responses(
    records: Sequence[Recording] | Recording,
    *,
    turns: int | None = None,
    where: Mapping[str, Wanted] | None = None,
    casing: Mapping[str, str] | None = None,
    stator: Mapping[str, float] | None = None,
    executor: Executor | None = None,
    progress: Callable[[str], None] | None = None,
) -> PerturbationTest:
    """Responses of a rotor to the force that turns with a perturbator or with the shaft itself.

    Where the frequency dwells, at one speed or at several in turn, each dwell gives a line; where it sweeps, lines are
    as many as the resonances need.

    Start-ups and shutdowns with the weight in one plane, at opposite places or at any others, or with it and without
    (mr = 0), are reduced together: residual unbalance, bow and run-out drop out. Of balance runs, whose shaft keeps its
    speed or dwells at some, each dwell gives the 1x vectors, and :func:`rotorfit.fit` solves them for the influence of
    the weights.

    Args:
        records: of one rig; see :func:`rotorfit.read_recording`.
        turns: track by windows of so many whole turns of the drive instead; for slow sweeps and rotors that are not
            linear. A sweep makes such vectors lag behind.
        where: responses to keep, ``{"frequency_hz": (60, 240)}``, as of :func:`rotorfit.read`.
        casing: plane of the sensors on a casing by plane of the rotor, as of :func:`rotorfit.read`.
        stator: plane of accelerometers on a floating stator and its mass, as of :func:`rotorfit.read`.
        executor: any ``concurrent.futures`` executor, also Dask's ``client.get_executor(pure=False)``, that reduces
            recordings beside each other; by default one after the other in this process. What a lost worker had is done
            again.
        progress: called with a few words before each stage.

    Returns:
        a row for each probe at each line; a synchronous test where the shaft itself drives. Lines that a record cannot
        tell from an order of the shaft are left out. What was found odd or limits what the recordings say, in
        themselves too, is in its ``findings``; errors are warned of.

    Raises:
        ValueError: a recording whose force is not known, or that is too short for what was swept; start-ups that are
            all without a weight.

    Example:
        >>> names = ["volts_journal-fwd.h5", "volts_journal-bwd.h5"]
        >>> test = rf.responses([rf.read_recording(rf.datasets.path(name)) for name in names])
        >>> test.runs, test.planes
        (('volts_journal-fwd', 'volts_journal-bwd'), ('disk', 'journal'))
    """
    test = checked_responses(named_apart(records), turns=turns, executor=executor, progress=progress)
    warn_of(found for found in test.findings if found.severity == "error")
    found = without_stator(with_casing(selected(test, where=where), casing), stator)
    _LOG.info("reduced %r", found)
    return found


def checked_responses(
    records: Sequence[Recording],
    *,
    turns: int | None,
    executor: Executor | None,
    progress: Callable[[str], None] | None,
) -> PerturbationTest:
    """As :func:`responses`, without a word about errors."""
    tell = progress or (lambda stage: None)
    forces = [force_of(record) for record in records]
    kinds = {driven_by(record): record.name for record in records}
    if len(kinds) > 1:
        (one, first), (other, second), *_ = kinds.items()
        raise ValueError(
            f"{first} is driven by {one}, {second} by {other}: two kinds of tests, call responses for each and give a "
            "list of both to fit"
        )
    findings = [*copied_recordings(records)]
    if not all(force.datum_known for force in forces):
        findings.append(_datum_finding(records))
    if forces[0].measured and turns:
        raise ValueError("windows of whole turns need a force that turns with a mark; this one was measured")
    jobs, work = _together(records, forces, turns, findings.append), partial(_reduced, turns=turns)
    if executor is None:
        reduced = carry_out(partial(work, tell=tell), jobs, None)
    else:
        tell(f"responses of {len(records)} recordings")
        reduced = carry_out(work, jobs, executor, lambda job, _: tell(f"reduced {', '.join(r.name for r in job[0])}"))
    shared = set.intersection(*(set(each.attributes) for each in reduced))
    test = join([replace(t, attributes={k: v for k, v in t.attributes.items() if k in shared}) for t in reduced])
    if forces[0].reference == "shaft" and turns:
        test = difference_unless_solved(test)
    told = told_once((*findings, *test.findings), [record.name for record in records])
    return replace(test, source=source_of(records), findings=told)


def _together(records: Sequence[Recording], forces: Sequence[Force], turns: int | None, report: Report) -> list[_Job]:
    """Recordings that are reduced together, and how many such groups their runs without a weight are part of."""
    pairs = list(zip(records, forces, strict=True))
    if forces[0].reference == "":
        both = [record for record, force in pairs if all(force.channels)]
        alone = [(record,) for record, force in pairs if not all(force.channels)]
        return [(group, 1) for group in (*states(both, report), *alone)]
    if forces[0].reference == "perturbator" and all(force.mr for force in forces):
        return [((record,), 1) for record in records]
    bare = [record for record, force in pairs if not force.mr]
    if forces[0].reference == "perturbator":
        raise ValueError(f"{bare[0].name}: a perturbator without unbalance (mr = 0) drives nothing")
    if len(bare) == len(records):
        raise ValueError(f"{listed([r.name for r in bare])}: no run has a weight (mr above 0): nothing is driven")
    steady = dwelling(records[0])
    if steady and not turns:
        _refuse_alone(pairs)
    if steady or turns:
        return [((record,), 1) for record in records]
    planes = dict.fromkeys(force.plane for _, force in pairs if force.mr)
    return [
        (tuple([record for record, force in pairs if force.mr and force.plane == plane] + bare), len(planes))
        for plane in planes
    ]


def _refuse_alone(pairs: Sequence[tuple[Recording, Force]]) -> None:
    """Refuse runs at steady speed of which nothing tells what the weight does."""
    weights = {(force.plane, force.mr * round(force.angle, 3), force.mr) for _, force in pairs}
    if len(weights) > 1:
        return
    record = pairs[0][0]
    rpm = float(np.mean(record.shaft_angle().speeds())) * RPM_PER_RAD_S
    raise ValueError(
        f"{record.name}: the shaft keeps its speed, {rpm:.0f} rpm, so this is no start-up; and no run without a weight "
        "(mr = 0) or with one elsewhere is beside it, so it is no balance run. If a perturbator drives the rotor, name "
        "its channel in [perturbator], or say steady = true where it has no mark; vectors at one speed: turns = 24 "
        "(--windows 24)"
    )


def _datum_finding(records: Sequence[Recording]) -> Finding:
    words = (
        "the angle between weight and mark is not known; fit with "
        'phase_offsets="common" (--phase-offsets common), one angle for all runs.'
    )
    unmarked = [r.name for r in records if r.rig.perturbator is not None and r.rig.perturbator.channel is None]
    if len(unmarked) > 1:
        words = (
            f"{listed(unmarked)} have no mark of the perturbator: the phases of each count "
            "from a datum of its own that nothing tells, so that a fit cannot take them together. Give it a mark."
        )
    return Finding("error" if len(unmarked) > 1 else "note", PHASE_DATUM, words)


def _reduced(job: _Job, *, turns: int | None, tell: Callable[[str], None] = lambda stage: None) -> PerturbationTest:
    """The responses of recordings that belong together, with what was odd, in the recordings themselves too."""
    found: list[Finding] = []
    records, groups = job
    tell(f"responses of {', '.join(record.name for record in records)}")
    usable = [_usable(record, found.append) for record in records]
    test = reduced_responses(usable, turns, found.append, groups)
    return replace(test, findings=(*found, *(finding for record in records for finding in record.findings)))


def _usable(record: Recording, report: Report) -> Recording:
    """The recording without probes that are dead, interrupted or clipped."""
    lost = spoiled(record.statistics)
    kept = tuple(probe for probe in record.probes if probe.channel not in lost)
    if not kept:
        first = next(f.message for f in probe_findings(record, record.statistics) if f.severity == "error")
        all_lost = f"{record.name}: all probes are dead, interrupted or clipped: {listed(lost)}. " if lost else ""
        raise ValueError(all_lost + first)
    if lost:
        words = f"{record.name}: {', '.join(lost)} left out: dead, interrupted or clipped."
        report(Finding("warning", "probe-left-out", words))
    return replace(record, rig=replace(record.rig, probes=kept))


def driven_by(record: Recording) -> str:
    """Force that drives the rotor of a recording, in words, where it is known."""
    kinds = {"perturbator": "a perturbator", "shaft": "the shaft itself", "": "a measured force"}
    reference = force_of(record).reference
    return kinds[reference] + (", at steady speeds" if reference == "shaft" and dwelling(record) else "")


BLOWS, LOADS = "blows", "constant loads"


def kind_of(record: Recording) -> str:
    """Kind of test that a recording is of: blows, constant loads, or the force that drives the rotor."""
    if record.force is not None:
        return driven_by(record)
    if record.rig.impulse is not None:
        return BLOWS
    if record.rig.load is not None:
        return LOADS
    raise ValueError(
        f"{record.name}: nothing says what drives the rotor: give plane, mr_kg_m and whirl in [force] of the setup, a "
        "constant load in [load], or [impulse] for blows and releases"
    )


def recorded_tests(
    records: Sequence[Recording],
    *,
    turns: int | None = None,
    executor: Executor | None = None,
    progress: Callable[[str], None] | None = None,
) -> tuple[Experiment, ...]:
    """One experiment for each kind of test that there is among recordings."""
    tell = progress or (lambda stage: None)
    kinds: dict[str, list[Recording]] = {}
    for record in named_apart(records):
        kinds.setdefault(kind_of(record), []).append(record)
    tests: list[Experiment] = []
    for kind, same in kinds.items():
        if kind not in (BLOWS, LOADS):
            tests.append(checked_responses(same, turns=turns, executor=executor, progress=progress))
            continue
        tell(f"{kind}: {', '.join(record.name for record in same)}")
        tests.append((ring_downs if kind == BLOWS else static_positions)(same, executor=executor))
    return tuple(tests)
