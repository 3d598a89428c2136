"""The words that the command line understands, and how they turn into settings."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.options.kinds import count_word, pairs, two_numbers
from rotorfit.options.table import FIT, MODEL, UNCERTAINTY
from rotorfit.units import RAD_S_PER_RPM

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from rotorfit.models.array_types import Float
    from rotorfit.studies.data_files import DataFile
    from rotorfit.studies.recording_files import RecordingFiles
    from rotorfit.studies.study import Study


def add_output(to: argparse.ArgumentParser) -> None:
    """How much is printed."""
    to.add_argument("--json", action="store_true", help="print the result as JSON instead of tables")
    to.add_argument("--quiet", action="store_true", help="print neither progress nor tables")


def add_figure_format(to: argparse.ArgumentParser, *, may_lack: bool = False) -> None:
    """Format of the figures in the folder for results, and of a report, whether it has figures and which."""
    one = to.add_mutually_exclusive_group()
    one.add_argument(
        "--figure-format",
        choices=("png", "pdf", "svg"),
        default="png",
        help="format of the figures in --out [%(default)s]",
    )
    if may_lack:
        words = "write no figures in --out, only tables, report and data files"
        one.add_argument("--no-figures", dest="figure_format", action="store_const", const="none", help=words)
        words = "add Bode plots to the report that can be zoomed and clicked; needs plotly and 5 MB"
        to.add_argument("--interactive", action="store_true", help=words)


def add_group(to: argparse.ArgumentParser) -> None:
    """Which values, of fits with one value of a parameter a condition."""
    words = "condition, of a fit with parameters per attribute (--per): speed_rpm=1000"
    to.add_argument("--at", action="append", default=[], metavar="NAME=VALUE", help=words)


def group(options: argparse.Namespace) -> dict[str, float | str]:
    """The condition that was named."""
    return pairs("--at", options.at, _number_or_text)


def _number_or_text(word: str) -> float | str:
    try:
        return float(word)
    except ValueError:
        return word


def add_files(to: argparse.ArgumentParser) -> None:
    """Test files and how they are read."""
    to.add_argument(
        "files",
        nargs="+",
        type=Path,
        metavar="FILE",
        help="test files (.csv .uff .nc .mat), recordings of raw signals (.h5 .tdms .wav)",
    )
    add_setup(to)
    to.add_argument(
        "--probe-angles",
        action="append",
        default=[],
        metavar="PLANE=X:Y",
        help="angles of the probes named x and y, degrees from X towards Y",
    )
    to.add_argument(
        "--slow-roll-below",
        type=float,
        metavar="RPM",
        help="subtract each channel's mean reading below this speed (synchronous tests)",
    )
    to.add_argument("--speed", type=float, metavar="RPM", help="rotative speed, for universal files without it")
    to.add_argument(
        "--axes", metavar="AB", help="directions of a universal file that are x and y: yz for a shaft along its x [xy]"
    )
    to.add_argument("--sheet", metavar="NAME", help="sheet of an Excel file [the first]")
    to.add_argument(
        "--constant",
        action="append",
        default=[],
        metavar="[FILE:]COLUMN=VALUE",
        help="value of a column that a table lacks: force_plane=disk, mr_g_mm=30; for one of several files: "
        "trial.csv:mr_g_mm=30",
    )
    to.add_argument(
        "--column",
        action="append",
        default=[],
        metavar="NAME=COLUMN",
        help="rotorfit's name of a column (in a machine's export: of a channel)",
    )
    rows = "readings by attribute (run, speed_rpm, plane, a column of the file): a value or a range LO:HI"
    to.add_argument(
        "--where",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help=f"keep only {rows}; repeat it for a further value",
    )
    to.add_argument("--exclude", action="append", default=[], metavar="NAME=VALUE", help=f"leave out {rows}")
    to.add_argument(
        "--drop-near-1x", type=float, metavar="PERCENT", help="leave out readings this close to the running speed"
    )


def add_setup(to: argparse.ArgumentParser) -> None:
    """Setup of the rig for recordings."""
    to.add_argument(
        "--setup",
        type=Path,
        metavar="rig.toml",
        help="setup of the rig with the channels of recordings; all files are then recordings",
    )
    to.add_argument(
        "--windows",
        type=count_word,
        metavar="TURNS",
        help="reduce recordings by windows of so many turns, for nonlinear rotors",
    )


def add_jobs(to: argparse.ArgumentParser, what: str) -> None:
    """Processes of this machine, or a cluster."""
    to.add_argument("--jobs", type=int, default=1, metavar="N", help=f"processes to {what} with [%(default)s]")
    to.add_argument(
        "--cluster", metavar="ADDRESS", help=f"Dask cluster to {what} with: local:8, or a scheduler's tcp://host:8786"
    )


def workers_of(options: argparse.Namespace) -> AbstractContextManager[Executor | None]:
    """An executor of the processes or the cluster that was asked for; None within for this process alone."""
    from rotorfit.executors import cluster, process_pool

    if options.jobs < 1:
        raise ValueError(f"--jobs takes a number of processes from 1, got {options.jobs}")
    if options.cluster and options.jobs > 1:
        raise ValueError("--jobs are processes of this machine, --cluster those of a cluster: give one of them")
    if options.cluster:
        return cluster(options.cluster)
    return process_pool(options.jobs) if options.jobs > 1 else nullcontext()


def add_model(to: argparse.ArgumentParser, options: Iterable[str] = MODEL) -> None:
    """The model, and options by name."""
    to.add_argument("--model", help="see `rotorfit models`; left out with --structure")
    add_options(to, options)


def model_name(options: argparse.Namespace) -> str:
    """The model, that of a shaft from a file where one is given."""
    from rotorfit.models import KnownStructure

    if options.model is None and not options.structure:
        raise ValueError("--model is missing: one that `rotorfit models` lists, or --structure with a shaft's file")
    return options.model or KnownStructure.name


def add_options(to: argparse._ActionsContainer, names: Iterable[str]) -> None:
    """Options from the table; what is not given is ``None``."""
    for option in map(FIT.__getitem__, names):
        kind = option.kind
        if kind.word is None:
            to.add_argument(option.word, dest=option.name, action="store_true", default=None, help=option.help)
        elif kind.bare:
            to.add_argument(
                option.word,
                dest=option.name,
                nargs="?",
                const=True,
                type=kind.word,
                metavar=option.metavar,
                help=option.help,
            )
        elif kind.paired:
            to.add_argument(option.word, dest=option.name, action="append", metavar=option.metavar, help=option.help)
        else:
            to.add_argument(option.word, dest=option.name, type=kind.word, metavar=option.metavar, help=option.help)


def add_fit_options(fit: argparse.ArgumentParser) -> None:
    """All that a single fit takes."""
    add_files(fit)
    fit.add_argument("--out", type=Path, help="folder for tables and figures")
    add_model(fit, [name for name in FIT if name not in UNCERTAINTY])
    add_options(fit.add_argument_group("uncertainty beyond standard errors"), UNCERTAINTY)


# ---- from words to settings -------------------------------------------------------------------


def data_files(options: argparse.Namespace) -> tuple[DataFile | RecordingFiles, ...]:
    """The files of the command line with their read options; recordings together are one test."""
    from rotorfit.recordings.formats.files import ALWAYS_RAW
    from rotorfit.studies.data_files import DataFile
    from rotorfit.studies.recording_files import RecordingFiles

    read: dict[str, Any] = {}
    if options.probe_angles:
        read["probe_angles"] = pairs("--probe-angles", options.probe_angles, two_numbers)
    if options.slow_roll_below is not None:
        read["slow_roll_below_rpm"] = options.slow_roll_below
    if options.speed is not None:
        read["speed"] = options.speed * RAD_S_PER_RPM
    read |= {name: getattr(options, name) for name in ("axes", "sheet") if getattr(options, name)}
    constants = _constants(options)
    if options.column:
        read["columns"] = pairs("--column", options.column, str)
    for name in ("where", "exclude"):
        if getattr(options, name):
            read[name] = chosen(f"--{name}", getattr(options, name))
    if options.drop_near_1x is not None:
        read["drop_near_1x"] = _share_near_1x(options.drop_near_1x)
    raw = tuple(file for file in options.files if options.setup or file.suffix.lower() in ALWAYS_RAW)
    if raw and (read or options.constant):
        raise ValueError(
            f"{raw[0].name} is a recording: what --probe-angles, --slow-roll-below and --speed say stands in its setup "
            "(--setup rig.toml); --axes, --sheet, --constant, --column, --where, --exclude and --drop-near-1x are for "
            "files of vectors"
        )
    tests = tuple(DataFile(file, read | constants[file]) for file in options.files if file not in raw)
    if raw:
        return (*tests, RecordingFiles(paths=raw, setup=options.setup, windows=options.windows))
    if options.windows is not None:
        raise ValueError(f"--windows is for recordings of raw signals, which {options.files[0].name} is not")
    return tests


def _constants(options: argparse.Namespace) -> dict[Path, dict[str, Any]]:
    """Option ``constants`` of each file: those for all, and those behind its own name."""
    words: dict[Path, list[str]] = {file: [] for file in options.files}
    for word in (part for given in options.constant for part in given.split(",")):
        name, colon, _ = word.partition("=")[0].rpartition(":")
        own = [file for file in options.files if name.strip() in (str(file), file.name)]
        if colon and not own:
            raise ValueError(
                f"--constant {word.strip()}: no file {name.strip()!r} is given; there are "
                f"{', '.join(file.name for file in options.files)}"
            )
        for file in own or options.files:
            words[file].append(word[len(name) + 1 :] if colon else word)
    return {file: {"constants": pairs("--constant", given, str)} if given else {} for file, given in words.items()}


def _share_near_1x(percent: float) -> float:
    if not 0 <= percent < 100:
        raise ValueError(f"--drop-near-1x is per cent of the speed, from 0 to below 100; got {percent:g}")
    return percent / 100


def chosen(option: str, words: Sequence[str]) -> dict[str, Any]:
    """Values of attributes: ``NAME=VALUE`` as often as there are values, or one range ``NAME=LO:HI``."""
    found: dict[str, Any] = {}
    for word in words:
        name, equals, value = word.partition("=")
        if not equals or not name or not value:
            raise ValueError(f"{option} takes NAME=VALUE or NAME=LO:HI, got {word!r}")
        low, colon, high = value.partition(":")
        try:
            ends = (float(low or "-inf"), float(high or "inf")) if colon else None
        except ValueError:
            ends = None  # a colon in a name
        if ends is not None:
            if name in found:
                raise ValueError(f"{option} {name} is given twice, one of them a range; give one range")
            found[name] = ends
        elif isinstance(found.get(name), tuple):
            raise ValueError(f"{option} {name} is given twice, one of them a range; give one range")
        else:
            found.setdefault(name, []).append(value)
    return found


def given(options: argparse.Namespace, names: Iterable[str]) -> dict[str, Any]:
    """Values of some options that were given, by the names that a study has for them."""
    found: dict[str, Any] = {}
    for option in map(FIT.__getitem__, names):
        value, parse = getattr(options, option.name), option.kind.word
        if value is not None:
            found[option.name] = pairs(option.word, value, parse) if option.kind.paired and parse else value
    return found


def fit_study(options: argparse.Namespace, names: Iterable[str] = tuple(FIT)) -> Study:
    """The study that the options of a command describe; see :func:`given`."""
    from rotorfit.studies.study import Study

    return Study(files=data_files(options), model=model_name(options), out=options.out, **given(options, names))


def numbers(text: str) -> Float:
    """Numbers with commas between; ``LO:HI:N`` stands for N of them evenly spaced."""
    import numpy as np

    parts = []
    for part in text.split(","):
        try:
            if ":" in part:
                low, high, count = part.split(":")
                parts.append(np.linspace(float(low), float(high), int(count)))
            else:
                parts.append(np.array([float(part)]))
        except ValueError:
            raise argparse.ArgumentTypeError(f"{part!r} is neither a number nor LO:HI:N") from None
    values = np.concatenate(parts)
    if not values.size or not np.isfinite(values).all():
        raise argparse.ArgumentTypeError(f"{text!r} must hold finite numbers")
    return values
