"""Recordings of raw signals: ``rotorfit look`` and ``vectors``."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rotorfit.apps.cli.answer import Answer, BadInputError, ProgressLine, answered, progress_line, sentences
from rotorfit.apps.cli.arguments import (
    WRITTEN,
    WRITTEN_JSON,
    add_jobs,
    add_paths,
    add_selection,
    add_setup,
    option,
    selection,
    workers_of,
)
from rotorfit.apps.cli.lists import RECORDING
from rotorfit.apps.study_files.data_files import RecordingFiles, read_files
from rotorfit.apps.study_files.folder import complete_folder
from rotorfit.apps.study_files.text import describe_test, finding_values, test_values
from rotorfit.base.atomic_file import file_name
from rotorfit.base.units import RAD_S_PER_RPM
from rotorfit.identify.options.kinds import positive_word
from rotorfit.lab.io.files import check_target, write
from rotorfit.lab.recordings.recording import Recording, named_apart, read_recording
from rotorfit.lab.recordings.rig.rig_toml import read_setup
from rotorfit.lab.recordings.rig.setup import RigSetup, SlowRollSetup
from rotorfit.lab.recordings.summary import summary

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def add_vectors(to: argparse.ArgumentParser) -> None:
    """Options of ``rotorfit vectors``."""
    add_paths(to, "recordings (.h5 .tdms .mat .wav .uff .csv)")
    add_setup(to)
    add_selection(to)
    option(to, "--out FILE", WRITTEN, Path, required=True)
    add_jobs(to, "reduce recordings")
    option(to, "--json", WRITTEN_JSON)
    option(to, "--quiet", "print neither progress nor findings")


@answered
def vectors(options: argparse.Namespace) -> Answer:
    """From recordings of raw signals to a file of responses with their noise."""
    check_target(options.out)  # before the work, which may take long
    paths = tuple(options.files)
    source = RecordingFiles(paths=paths, setup=options.setup, windows=options.windows, **selection(options))
    with progress_line(options) as progress, workers_of(options) as workers:
        tests, found = read_files([source], progress, workers)
    if len(tests) > 1:
        titles = " and ".join(test.title for test in tests)
        raise BadInputError(f"the recordings are a {titles}: a file holds one kind of test, give those of one kind")
    (test,), (findings,) = tests, found
    write(test, options.out)
    return Answer(
        text=describe_test(test, findings),
        plain=lambda: test_values(test, findings),
        warned=sentences([findings], [test.source or test.title]),
        good=not any(finding.severity == "error" for finding in findings),
    )


# ---- look -------------------------------------------------------------------------------------


def add_look(to: argparse.ArgumentParser) -> None:
    """Options of ``rotorfit look``."""
    add_paths(to, RECORDING)
    option(to, "--setup RIG.toml", "setup of the rig, see `rotorfit template`", Path)
    option(to, "--out DIR", "folder for the figures; without it only the summary is printed", Path)
    option(to, "--plane PLANE", "only this plane")
    option(to, "--at S", "time of the time base and the orbits [the middle]", float)
    option(to, "--clearance-um UM", "radial clearance, drawn in orbits and centrelines", positive_word)
    words = "subtract run-out, from the part below this speed or from a recording of slow turning"
    option(to, "--slow-roll RPM|FILE", words)
    option(to, "--json", "print what each recording holds as JSON instead of its summary")
    option(to, "--quiet", "print no progress and no summary")


@answered
def look(options: argparse.Namespace) -> Answer:
    """What recordings hold, in words and in figures."""
    setup = options.setup if options.slow_roll is None else _with_slow_roll(options.setup, options.slow_roll)
    records = named_apart([read_recording(file, setup) for file in options.files])
    for record in records:
        if options.at is not None and not 0 <= options.at <= record.duration:
            raise ValueError(f"--at {options.at:g} is not within {record.name}, 0 to {record.duration:g} s")
        if options.plane is not None:
            record.motion(options.plane, 0, 0)  # refuses a plane that there is not, before anything is drawn
    texts = [summary(record) for record in records]
    left_out: list[str] = []
    if options.out is not None:
        with progress_line(options) as progress, complete_folder(options.out) as folder:
            names: list[str] = []
            for record, text in zip(records, texts, strict=True):
                names.append(file_name(record.name, names))
                stem = f"{names[-1]}-" if len(records) > 1 else ""
                left_out += _draw(record, options, folder, stem, progress)
                (folder / f"{stem}summary.txt").write_text(text + "\n", encoding="utf-8")
    findings = [record.findings for record in records]
    return Answer(
        text="\n\n".join([*texts, *(["\n".join(left_out)] if left_out else [])]),
        plain=lambda: [
            {
                "name": record.name,
                "duration_s": record.duration,
                "planes": record.planes,
                "findings": finding_values(record.findings),
            }
            for record in records
        ],
        warned=sentences(findings, [record.name for record in records]),
        good=not any(finding.severity == "error" for own in findings for finding in own),
    )


def _draw(record: Recording, options: argparse.Namespace, folder: Path, stem: str, progress: ProgressLine) -> list[str]:
    """Write the figures that the recording has; returns why others are left out."""
    from rotorfit.show.plots.style import picture_of

    left_out = []
    figures = _figures(record, options)
    for number, (name, draw) in enumerate(figures.items()):
        progress(f"{record.name}: {name}", number / len(figures))
        try:
            figure = draw()
        except ValueError as problem:
            left_out.append(f"no {name.replace('_', ' ')}: {problem}")
        else:
            (folder / f"{stem}{name}.png").write_bytes(picture_of(figure, dpi=150))
    return left_out


def _with_slow_roll(setup: Path | None, given: str) -> RigSetup:
    """The setup with run-out to be taken out: a speed in rpm, or the file of a recording of slow turning."""
    try:
        below, file = float(given) * RAD_S_PER_RPM, None
    except ValueError:
        below, file = None, str(Path(given).resolve())
    if (file is not None and not Path(file).is_file()) or (below is not None and not 0 < below < math.inf):
        raise ValueError(f"--slow-roll is {given}: neither a speed in rpm above zero nor a file that there is")
    said = RigSetup(source="--slow-roll") if setup is None else read_setup(setup)
    return replace(said, slow_roll=SlowRollSetup(below=below, file=file))


def _figures(record: Recording, options: argparse.Namespace) -> dict[str, Callable[[], Figure]]:
    """The function that draws each figure, by the name of its file."""
    plane, at = options.plane, options.at
    clearance = None if options.clearance_um is None else options.clearance_um * 1e-6
    figures: dict[str, Callable[[], Figure]] = {
        "timebase": lambda: record.plot.timebase(plane, at=at),
        "orbit": lambda: record.plot.orbit(plane, at=at, clearance=clearance),
        "centreline": lambda: record.plot.centreline(plane, clearance=clearance),
        "full_spectrum": lambda: record.plot.full_spectrum(plane),
        "bode": record.plot.bode,
        "polar": record.plot.polar,
        "speed": record.plot.speed,
    }
    if record.rig.twist is not None:
        figures["twist"] = record.plot.twist
    for each in (plane,) if plane is not None else record.planes:
        figures[file_name(f"cascade_{each}", figures)] = partial(record.plot.cascade, each)
    return figures
