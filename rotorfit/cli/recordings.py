"""``rotorfit template`` and ``rotorfit look``: a setup to fill in for a recording, and figures of what it holds."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from rotorfit.cli.answer import say_findings
from rotorfit.cli.errors import ExitCode, checked
from rotorfit.cli.progress import ProgressLine
from rotorfit.estimators.atomic_file import file_name
from rotorfit.io.templates import example, kinds
from rotorfit.models.parameters import unknown_name
from rotorfit.units import RAD_S_PER_RPM

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rotorfit.recordings.recording import Recording
    from rotorfit.recordings.rig.setup import RigSetup

TEMPLATE = "print an example file with comments, or a setup, rig.toml, to fill in for a recording of raw signals"
LOOK = "summarise recordings of raw signals with their findings, and draw them"
FORMATS = "recording (.h5 .tdms .mat .npz .wav .uff .csv .parquet)"


def add_template_options(to: argparse.ArgumentParser) -> None:
    """Options of ``rotorfit template``."""
    to.add_argument("what", metavar="KIND|FILE", help=f"{', '.join(kinds())}; or a {FORMATS}")


def add_look_options(to: argparse.ArgumentParser) -> None:
    """Options of ``rotorfit look``."""
    to.add_argument("files", nargs="+", type=Path, metavar="FILE", help=FORMATS)
    to.add_argument("--setup", type=Path, metavar="RIG.toml", help="setup of the rig, see `rotorfit template`")
    to.add_argument(
        "--out", type=Path, metavar="DIR", help="folder for the figures; without it only the summary is printed"
    )
    to.add_argument("--plane", help="only this plane")
    to.add_argument("--at", type=float, metavar="S", help="time of the time base and the orbits [the middle]")
    to.add_argument(
        "--clearance-um", type=float, metavar="UM", help="radial clearance, drawn in orbits and centrelines"
    )
    to.add_argument(
        "--slow-roll",
        metavar="RPM|FILE",
        help="subtract run-out, from the part below this speed or from a recording of slow turning",
    )
    to.add_argument("--quiet", action="store_true", help="print no progress and no summary")


def run_template(options: argparse.Namespace) -> int:
    """Print the example or the setup; returns the exit code."""
    sys.stdout.write(checked(lambda: _template(options.what)))
    return ExitCode.DONE


def _template(what: str) -> str:
    if what in kinds():
        return example(what)
    if not Path(what).exists() and not Path(what).suffix:
        raise ValueError(f"{unknown_name('kind of file', what, kinds())}; nor is there a recording of that name")
    from rotorfit.recordings.rig.template import template

    return template(Path(what))


def run_look(options: argparse.Namespace) -> int:
    """Print what the recordings hold, write their figures; returns the exit code."""
    return checked(lambda: _look(options))


def _look(options: argparse.Namespace) -> int:
    from rotorfit.recordings.recording import named_apart, read_recording
    from rotorfit.recordings.summary import summary
    from rotorfit.studies.folder import complete_folder

    if options.clearance_um is not None and not 0 < options.clearance_um < math.inf:
        raise ValueError(f"--clearance-um is {options.clearance_um:g}; it is a radius above zero")
    setup = options.setup if options.slow_roll is None else _with_slow_roll(options.setup, options.slow_roll)
    records = named_apart([read_recording(file, setup) for file in options.files])
    for record in records:
        if options.at is not None and not 0 <= options.at <= record.duration:
            raise ValueError(f"--at {options.at:g} is not within {record.name}, 0 to {record.duration:g} s")
        if options.plane is not None:
            record.motion(options.plane, 0, 0)  # refuses a plane that there is not, before anything is drawn
    texts = [summary(record) for record in records]
    if not options.quiet:
        print("\n\n".join(texts))
    else:
        say_findings([record.findings for record in records], [record.name for record in records])
    wrong = any(finding.severity == "error" for record in records for finding in record.findings)
    if options.out is None:
        return ExitCode.NOT_CONVERGED if wrong else ExitCode.DONE
    progress = ProgressLine(enabled=not options.quiet and sys.stderr.isatty())
    left_out: list[str] = []
    try:
        with complete_folder(options.out) as folder:
            names: list[str] = []
            for record, text in zip(records, texts, strict=True):
                names.append(file_name(record.name, names))
                stem = f"{names[-1]}-" if len(records) > 1 else ""
                left_out += _draw(record, options, folder, stem, progress)
                (folder / f"{stem}summary.txt").write_text(text + "\n", encoding="utf-8")
    finally:
        progress.close()
    if not options.quiet:
        print("\n".join(["", *left_out, f"written to {options.out}"]))
    return ExitCode.NOT_CONVERGED if wrong else ExitCode.DONE


def _draw(record: Recording, options: argparse.Namespace, folder: Path, stem: str, progress: ProgressLine) -> list[str]:
    """Write the figures that the recording has; returns why others are left out."""
    from rotorfit.plots.style import picture_of

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
    from rotorfit.recordings.rig.rig_toml import read_setup
    from rotorfit.recordings.rig.setup import RigSetup, SlowRollSetup

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
        "timebase": lambda: record.plot_timebase(plane, at=at),
        "orbit": lambda: record.plot_orbit(plane, at=at, clearance=clearance),
        "centreline": lambda: record.plot_centreline(plane, clearance=clearance),
        "full_spectrum": lambda: record.plot_full_spectrum(plane),
        "bode": record.plot_bode,
        "polar": record.plot_polar,
        "speed": record.plot_speed,
    }
    if record.rig.twist is not None:
        figures["twist"] = record.plot_twist
    for each in (plane,) if plane is not None else record.planes:
        figures[file_name(f"cascade_{each}", figures)] = partial(record.plot_cascade, each)
    return figures
