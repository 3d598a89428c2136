"""``rotorfit trend``: follow dated tests of one machine and report changes."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.cli.answer import Answer, checked
from rotorfit.cli.arguments import add_false_alarm, add_files, add_output, check_false_alarm, data_files, option
from rotorfit.options.kinds import two_numbers

if TYPE_CHECKING:
    from rotorfit.monitoring.trend import DatedValues, MachineTrend, PlaceTrend

HELP = (
    "follow the observed stiffness, mass and damping of dated tests of one machine, or dK/K of saved fits (.json) of "
    "a shaft that is not round, and report changes"
)


def add_options(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_files(to)
    option(to, "--speed-range LO:HI", "speeds to use, rpm; stay below the next critical")
    add_false_alarm(to, "probability of reporting a change when there is none [%(default)g]")
    add_output(to, "trend.csv, summary.txt and trend.png")


def answer(options: argparse.Namespace) -> Answer:
    """Dated tests of one machine, and what changed."""
    found = _trend(options)
    return Answer(
        text=str(found), write=partial(_write, found), plain=lambda: [place_json(place) for place in found.places]
    )


def _trend(options: argparse.Namespace) -> MachineTrend:
    from rotorfit.data.experiments import PerturbationTest
    from rotorfit.monitoring.observed_stiffness import observed_stiffness
    from rotorfit.monitoring.trend import trend
    from rotorfit.studies.data_files import no_progress, read_files

    check_false_alarm(options)
    try:
        limits = two_numbers(options.speed_range) if options.speed_range else None
    except ValueError as problem:
        raise ValueError(f"--speed-range {options.speed_range}: {problem}") from problem
    if all(file.suffix == ".json" for file in options.files):
        from rotorfit.fitting.fit_file import load_fit
        from rotorfit.monitoring.trend import dated_anisotropy

        def dated(file: Path) -> DatedValues:
            return checked(lambda: dated_anisotropy(load_fit(file)), file)

        return trend([dated(file) for file in options.files], false_alarm=options.false_alarm)
    tests = []
    for test in read_files(data_files(options), no_progress)[0]:
        if not isinstance(test, PerturbationTest):
            raise ValueError(f"{test.source}: a {test.title} has no observed stiffness: a synchronous test is needed")
        tests += observed_stiffness(test, speed_rpm=limits)
    return trend(tests, false_alarm=options.false_alarm)


def _write(found: MachineTrend, folder: Path) -> None:
    from rotorfit.io.tables.result_tables import rows_csv
    from rotorfit.plots.style import picture_of

    rows: list[list[Any]] = [["place", "test", "quantity", "unit", "value", "stderr"]]
    for place in found.places:
        for i, date in enumerate(place.dates):
            for j, name in enumerate(place.names):
                rows.append([place.place, date, name, place.units[j], place.values[i, j], place.stderr[i, j]])
    (folder / "trend.csv").write_text(rows_csv(rows), encoding="utf-8")
    (folder / "summary.txt").write_text(f"{found}\n", encoding="utf-8")
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
