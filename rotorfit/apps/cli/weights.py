"""Runs with trial weights: ``rotorfit join`` and ``balance``."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.apps.cli.answer import Answer, answered, sentences
from rotorfit.apps.cli.arguments import WRITTEN, WRITTEN_JSON, add_files, add_output, data_files, option
from rotorfit.apps.study_files.data_files import DataFile, no_progress, read_files
from rotorfit.apps.study_files.text import describe_test, test_values
from rotorfit.base.units import RAD_S_PER_RPM, RPM_PER_RAD_S
from rotorfit.identify.diagnosis.check import check
from rotorfit.identify.options.kinds import number_word, pairs
from rotorfit.identify.options.kinds import words as comma_words
from rotorfit.lab.data.balancing import Balance, run_up
from rotorfit.lab.data.balancing import balance as balanced
from rotorfit.lab.data.experiments import PerturbationTest, perturbations
from rotorfit.lab.data.findings import errors_in
from rotorfit.lab.data.joined import join_runs
from rotorfit.lab.data.weights import Influences, influence
from rotorfit.lab.io.files import check_target, write
from rotorfit.lab.io.tables.result_tables import records_csv


def add_join(to: argparse.ArgumentParser) -> None:
    """Options of ``rotorfit join``."""
    add_files(to)
    option(to, "--out FILE", WRITTEN, Path, required=True)
    option(to, "--json", WRITTEN_JSON)
    option(to, "--quiet", "do not say what the file holds")


@answered
def join(options: argparse.Namespace) -> Answer:
    """A run without a trial weight and runs with one that stand in several files, as one file."""
    check_target(options.out)
    write(_joined_runs(options), options.out)
    (whole,), (findings,) = read_files([DataFile(options.out)], no_progress)
    return Answer(
        text=describe_test(whole, findings),
        plain=lambda: test_values(whole, findings),
        warned=sentences([findings], [whole.source]),
    )


def _joined_runs(options: argparse.Namespace) -> PerturbationTest:
    """Runs of all files, not differenced."""
    files = []
    for file in data_files(options):
        if not isinstance(file, DataFile):
            raise ValueError(f"{file.paths[0].name} is a recording: make vectors of it first, `rotorfit vectors`")
        files.append(DataFile(file.path, {**file.options, "difference": False}))
    tests, _ = read_files(files, no_progress)
    for test in tests:
        if test.perturbation is None:
            raise ValueError(f"{test.source}: a {test.title} cannot be joined: it has no runs with a force")
    return join_runs(perturbations(tests), difference=False)


def add_balance(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_files(to)
    words = "run whose vibration is to be corrected; its weights stay in [the rotor without any weight]"
    option(to, "--reference RUN", words)
    option(to, "--planes A,B", "planes to put weights in [all that were tried]", comma_words)
    words = "speeds at which start-ups are read, rpm [those at which runs dwell]"
    option(to, "--speeds RPM,RPM", words, comma_words)
    words = "largest weight, mass times radius, of every plane or of one; repeat it for a further plane"
    option(to, "--max-g-mm [PLANE=]G_MM ...", words)
    words = "split weights over N even holes, the first at zero degrees of force_phase_deg"
    option(to, "--holes [PLANE=]N ...", words)
    words = "smallest weight that can be mounted, of every plane or of one: weights are whole multiples of it"
    option(to, "--smallest-g-mm [PLANE=]G_MM ...", words)
    words = "what remains with these, angles as force_phase_deg; in two holes of a plane: A=300@210,A=200@225"
    option(to, "--weights PLANE=G_MM@DEG,... ...", words)
    add_output(
        to,
        "weights.csv, readings.csv, summary.txt, report.html, vibration.png, and run_up.csv of start-ups",
        figures=True,
    )


@answered
def balance(options: argparse.Namespace) -> Answer:
    """Weights, and how the rotor will vibrate with them."""
    test, influences, found = _balance(options)
    errors = errors_in(check(influences.measured))
    text = f"influences of weights, +- are standard errors\n{influences}\n\n{found}"
    text = "\n".join([*(f"ERROR in the data: {words}" for words in errors), text])
    return Answer(
        text=text,
        files=lambda: {
            "weights.csv": records_csv(_weights(found)),
            "readings.csv": records_csv(_readings(found)),
            "summary.txt": f"{text}\n",
            **_drawn(test, found, errors, options),
        },
        plain=lambda: {"errors": list(errors), **_plain(found)},
        warned=found.remarks,
        said=[f"error in the data: {words}" for words in errors],
        good=not errors,
    )


def _balance(options: argparse.Namespace) -> tuple[PerturbationTest, Influences, Balance]:
    def weight(word: str) -> float:
        """A weight in g mm as kg m."""
        if not number_word(word) > 0:
            raise ValueError("a weight is above zero")
        return number_word(word) * 1e-6

    def count(word: str) -> int:
        if not word.isdecimal():
            raise ValueError(f"{word!r} is not a number of holes")
        return int(word)

    limits, holes = _by_plane("--max-g-mm", options.max_g_mm, weight), _by_plane("--holes", options.holes, count)
    speeds = [number_word(one) * RAD_S_PER_RPM for one in options.speeds] if options.speeds else None
    smallest = _by_plane("--smallest-g-mm", options.smallest_g_mm, weight)
    test = _joined_runs(options)
    influences = influence(test, speeds)
    found = balanced(
        influences,
        options.reference,
        planes=options.planes,
        limits=limits,
        holes=holes,
        smallest=smallest,
        weights=_given_weights(options.weights),
    )
    return test, influences, found


def _given_weights(words: Sequence[str]) -> dict[str, complex] | None:
    """Weights by plane, kg m; those of one plane in several holes added up."""
    found: dict[str, complex] = {}
    for word in (part.strip() for one in words for part in one.split(",")):
        plane, equals, value = word.rpartition("=")
        size, at, angle = value.partition("@")
        if not (equals and plane and at):
            raise ValueError(f"--weights takes PLANE=G_MM@DEG, A=500@210; got {word!r}")
        try:
            put = number_word(size) * 1e-6 * complex(np.exp(1j * np.radians(number_word(angle))))
        except ValueError as problem:
            raise ValueError(f"--weights {word}: {problem}") from problem
        found[plane.strip()] = found.get(plane.strip(), 0j) + put
    return found or None


def _drawn(
    test: PerturbationTest, found: Balance, errors: Sequence[str], options: argparse.Namespace
) -> dict[str, Any]:
    """Report, table and figure of the vibration before and after: of start-ups over all their speeds."""
    from rotorfit.show.plots.style import picture_of
    from rotorfit.show.report.balance import write_balance_report

    kind = options.figure_format
    over = run_up(test, found, options.reference) if options.speeds else found
    table = {"run_up.csv": records_csv(_readings(over))} if options.speeds else {}
    curve = over if options.speeds else None
    report = partial(write_balance_report, found, curve=curve, errors=errors, source=test.source)
    return {**table, "report.html": report, f"vibration.{kind}": picture_of(over.plot(), kind)}


def _by_plane(option: str, given: Sequence[str], parse: Callable[[str], Any]) -> Any:
    """One value for all planes, or values by plane; None where the option was not given."""
    if len(given) == 1 and "=" not in given[0]:
        try:
            return parse(given[0])
        except ValueError as problem:
            raise ValueError(f"{option} {given[0]}: {problem}") from problem
    return pairs(option, given, parse) or None


def _weights(found: Balance) -> list[dict[str, Any]]:
    rows = []
    for plane, weight in zip(found.planes, found.weight.tolist(), strict=True):
        (low, high), (early, late) = found.interval(plane)
        rows.append(
            {
                "plane": plane,
                "mr_g_mm": abs(weight) * 1e6,
                "mr_low_g_mm": low * 1e6,
                "mr_high_g_mm": high * 1e6,
                "force_phase_deg": float(np.degrees(np.angle(weight))),
                "phase_low_deg": float(np.degrees(early)),
                "phase_high_deg": float(np.degrees(late)),
                "at_limit": plane in found.at_limit,
            }
        )
    return rows


def _readings(found: Balance) -> list[dict[str, Any]]:
    columns = zip(found.readings, found.speed, found.before, found.expected, found.stderr, strict=True)
    return [
        {
            "plane": plane,
            "direction": direction,
            "speed_rpm": float(np.round(speed * RPM_PER_RAD_S, 6)),
            "before_um": float(abs(before) * 1e6),
            "before_phase_deg": float(np.degrees(np.angle(before))),
            "expected_um": float(abs(expected) * 1e6),
            "expected_phase_deg": float(np.degrees(np.angle(expected))),
            "stderr_um": float(error * 1e6),
        }
        for (plane, direction), speed, before, expected, error in columns
    ]


def _plain(found: Balance) -> dict[str, Any]:
    holes = {
        plane: [{"angle_deg": float(np.degrees(angle)), "mr_g_mm": mr * 1e6} for angle, mr in pair]
        for plane, pair in found.holes.items()
    }
    more = {name: getattr(found, name) for name in ("freedom", "remarks")}
    return {"weights": _weights(found), "holes": holes, "readings": _readings(found), **more}
