"""From recordings of any kinds of tests to the experiments that a fit takes, by what the recordings say."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor

from rotorfit.data.experiments import Experiment
from rotorfit.data.findings import Finding
from rotorfit.executors import carry_out
from rotorfit.recordings.recording import Recording, named_apart
from rotorfit.recordings.reduction.response_lines import Report
from rotorfit.recordings.reduction.responses import checked_responses, driven_by
from rotorfit.recordings.reduction.ring_downs import ring_downs
from rotorfit.recordings.reduction.static_positions import static_positions

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
    on_finding: Report | None = None,
    progress: Callable[[str], None] | None = None,
) -> tuple[Experiment, ...]:
    """One experiment for each kind of test that there is among recordings."""
    if not records:
        raise ValueError("no recordings given")
    report = on_finding or (lambda finding: None)
    tell = progress or (lambda stage: None)
    kinds: dict[str, list[Recording]] = {}
    for record in named_apart(records):
        kinds.setdefault(kind_of(record), []).append(record)
    tests: list[Experiment] = []
    for kind, same in kinds.items():
        if kind not in (BLOWS, LOADS):
            tests.append(checked_responses(same, turns=turns, executor=executor, on_finding=report, progress=progress))
            continue
        tell(f"{kind}: {', '.join(record.name for record in same)}")
        blows = kind == BLOWS
        tests.append(
            ring_downs(same, executor=executor)
            if blows
            else static_positions(same, executor=executor, on_finding=report)
        )
        for findings in carry_out(_findings, same, executor):
            for finding in findings:
                report(finding)
    return tuple(tests)


def _findings(record: Recording) -> tuple[Finding, ...]:
    return record.findings
