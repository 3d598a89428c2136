"""States of a rig that is shaken along x and then along y: recordings that are reduced together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from rotorfit.estimators.blocks.set_speeds import set_speeds
from rotorfit.lab.data.findings import Finding, listed
from rotorfit.lab.recordings.recording import Recording
from rotorfit.lab.recordings.reduction.measured_responses import shaken_along
from rotorfit.lab.recordings.reduction.response_lines import Report


def states(records: Sequence[Recording], report: Report) -> list[tuple[Recording, ...]]:
    """Recordings of each state of a rig whose forces were measured along both axes. A word of two values of which one
    stands for x and the other for y tells them apart; any other attribute makes states, and is named where a run along
    one axis is left without one along the other."""
    axis = {record.name: shaken_along(record) for record in records}
    told = [name for name in _names(records) if _tells(name, records, axis)]
    stated = [record.speed for record in records]
    common = set_speeds(np.array([speed or 0.0 for speed in stated]), np.zeros(len(records)), np.arange(len(records)))
    found: dict[object, list[Recording]] = {}
    for record, speed, own in zip(records, stated, common.tolist(), strict=True):
        plane = record.force.plane if record.force else ""
        attributes = sorted((name, value) for name, value in record.attributes.items() if name not in told)
        found.setdefault((plane, None if speed is None else own, tuple(attributes)), []).append(record)
    groups = [tuple(group) for group in found.values()]
    for words in _apart(groups, axis):
        report(Finding("warning", "shaken-apart", words))
    return groups


def _names(records: Iterable[Recording]) -> list[str]:
    return list(dict.fromkeys(name for record in records for name in record.attributes))


def _tells(name: str, records: Sequence[Recording], axis: dict[str, str]) -> bool:
    """True if a word of two values says along which axis a recording was shaken."""
    pairs = {(record.attributes.get(name), axis[record.name]) for record in records}
    values = {value for value, _ in pairs}
    return len(pairs) == len(values) == 2 and all(isinstance(value, str) for value in values)


def _apart(groups: Sequence[Sequence[Recording]], axis: dict[str, str]) -> list[str]:
    """What keeps runs along x from those along y."""
    alone: dict[str, list[Recording]] = {"x": [], "y": []}
    for group in groups:
        if len({axis[record.name] for record in group}) == 1:
            alone[axis[group[0].name]].append(group[0])
    if not (alone["x"] and alone["y"]):
        return []
    one, other = alone["x"][0], alone["y"][0]
    differing = [name for name in _names((one, other)) if one.attributes.get(name) != other.attributes.get(name)]
    values = [f"{name} ({one.attributes.get(name)}, {other.attributes.get(name)})" for name in differing]
    if not values:
        return []
    return [
        f"{one.name} was shaken along x, {other.name} along y: they are reduced apart, because they differ in "
        f"{listed(values)}. Take out of file or setup what differs, if both are of one state of the rig; cross-talk of "
        "the shakers is taken out only of runs reduced together."
    ]
