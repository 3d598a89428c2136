"""``rotorfit trend``: follow dated tests of one machine and report changes."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.cli.answer import give
from rotorfit.cli.arguments import add_files, add_output, data_files
from rotorfit.options.kinds import positive_word, two_numbers

if TYPE_CHECKING:
    from rotorfit.monitoring.trend import DatedValues, MachineTrend, PlaceTrend

DESCRIPTION = (
    "follow the observed stiffness, mass and damping of dated tests of one machine, or dK/K of saved fits (.json) of "
    "a shaft that is not round, and report changes"
)


def add_options(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_files(to)
    to.add_argument("--speed-range", metavar="LO:HI", help="speeds to use, rpm; stay below the next critical")
    to.add_argument(
        "--false-alarm",
        type=positive_word,
        default=0.01,
        metavar="P",
        help="probability of reporting a change when there is none [%(default)g]",
    )
    to.add_argument("--out", type=Path, help="folder for trend.csv, summary.txt and trend.png")
    add_output(to)


def run(options: argparse.Namespace) -> int:
    """Do what the command line says; returns the exit code."""
    from rotorfit.cli.errors import ExitCode, checked

    found = checked(lambda: _trend(options))
    give(options, partial(_write, found), lambda: [place_json(place) for place in found.places], str(found))
    return ExitCode.DONE


def _trend(options: argparse.Namespace) -> MachineTrend:
    from rotorfit.data.experiments import PerturbationTest
    from rotorfit.monitoring.observed_stiffness import observed_stiffness
    from rotorfit.monitoring.trend import trend
    from rotorfit.studies.data_files import no_progress, read_files

    if options.false_alarm >= 1:
        raise ValueError(f"--false-alarm takes a probability below 1, got {options.false_alarm:g}")
    try:
        limits = two_numbers(options.speed_range) if options.speed_range else None
    except ValueError as problem:
        raise ValueError(f"--speed-range {options.speed_range}: {problem}") from problem
    if all(file.suffix == ".json" for file in options.files):
        return _crack_monitor(options)
    tests = []
    for test in read_files(data_files(options), no_progress)[0]:
        if not isinstance(test, PerturbationTest):
            raise ValueError(f"{test.source}: a {test.title} has no observed stiffness: a synchronous test is needed")
        tests += observed_stiffness(test, speed_rpm=limits)
    return trend(tests, false_alarm=options.false_alarm)


def _crack_monitor(options: argparse.Namespace) -> MachineTrend:
    """Follow dK/K of saved fits."""
    from rotorfit.cli.errors import checked
    from rotorfit.monitoring.trend import trend

    dated = [checked(partial(_dated_anisotropy, file), file) for file in options.files]
    return trend(dated, false_alarm=options.false_alarm)


def _dated_anisotropy(file: Path) -> DatedValues:
    from rotorfit.fitting.fit_file import load_fit
    from rotorfit.monitoring.crack import dated_anisotropy

    return dated_anisotropy(load_fit(file))


def _rows(found: MachineTrend) -> list[list[Any]]:
    return [
        [place.place, date, name, place.units[j], place.values[i, j], place.stderr[i, j]]
        for place in found.places
        for i, date in enumerate(place.dates)
        for j, name in enumerate(place.names)
    ]


def _write(found: MachineTrend, folder: Path) -> None:
    from rotorfit.io.tables.result_tables import rows_csv

    rows = [["place", "test", "quantity", "unit", "value", "stderr"], *_rows(found)]
    (folder / "trend.csv").write_text(rows_csv(rows), encoding="utf-8")
    (folder / "summary.txt").write_text(f"{found}\n", encoding="utf-8")
    from rotorfit.plots.style import picture_of

    (folder / "trend.png").write_bytes(picture_of(found.plot(), dpi=150))


def place_json(place: PlaceTrend) -> dict[str, Any]:
    """One place as JSON, SI units."""
    change = place.change
    return {
        "place": place.place,
        "tests": list(place.dates),
        "changed": place.found,
        "p_value": None if change is None else change.p_value,
        "first_after": place.dates[change.index] if change is not None and place.found else None,
        "before": dict(zip(place.names, change.before.tolist(), strict=True)) if change is not None else None,
        "after": dict(zip(place.names, change.after.tolist(), strict=True)) if change is not None else None,
        "causes": [
            {"name": c.name, "change": c.size, "stderr": c.stderr, "probability": c.probability} for c in place.causes
        ],
        "said": place.sentences(),
    }
