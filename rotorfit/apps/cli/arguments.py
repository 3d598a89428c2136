"""The words that the command line understands, and how they turn into settings."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, nullcontext
from inspect import signature
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.apps.study_files.data_files import DataFile, RecordingFiles
from rotorfit.apps.study_files.study import Study
from rotorfit.base.array_types import Float
from rotorfit.base.executors import cluster, process_pool
from rotorfit.base.names import unknown_name
from rotorfit.base.units import RAD_S_PER_RPM, UNITS, Shown
from rotorfit.identify.options.kinds import count_word, is_set, pairs, probability_word, two_numbers
from rotorfit.identify.options.table import FIT, SEARCH, SHAFT, UNCERTAINTY
from rotorfit.lab.recordings.formats.files import ALWAYS_RAW
from rotorfit.models import KnownStructure

WRITTEN = "file to write (.csv .uff .nc .mat)"
WRITTEN_JSON = "print what was written as JSON instead of text"


def option(
    to: argparse._ActionsContainer,
    written: str,
    help: str,
    kind: Callable[[str], Any] = str,
    *,
    of: Callable[..., Any] | None = None,
    **more: Any,
) -> None:
    """An option as its help writes it: ``--speed RPM``. With nothing behind it it is a flag; with ``...`` at the end
    it may be given again. Its default is that of the function ``of`` which it is handed to by this name."""
    word, _, value = written.partition(" ")
    if of is not None:
        more["default"] = signature(of).parameters[word[2:].replace("-", "_")].default
    if not value:
        to.add_argument(word, action="store_true", help=help, **more)
    elif value.endswith(" ..."):
        to.add_argument(word, action="append", default=[], metavar=value.removesuffix(" ..."), help=help, **more)
    else:
        to.add_argument(word, type=kind, metavar=value, help=help, **more)


def add_output(to: argparse.ArgumentParser, out: str = "", *, figures: bool = False) -> None:
    """Folder for what is found, the format of figures in it, and how much is printed."""
    if out:
        option(to, "--out OUT", f"folder for {out}", Path)
    if figures:
        add_figure_format(to)
    option(to, "--json", "print the result as JSON instead of tables")
    option(to, "--quiet", "print neither progress nor tables")


def add_figure_format(to: argparse.ArgumentParser) -> argparse._MutuallyExclusiveGroup:
    """Format of the figures in the folder for results."""
    one = to.add_mutually_exclusive_group()
    words = "format of the figures in --out [%(default)s]"
    one.add_argument("--figure-format", choices=("png", "pdf", "svg"), default="png", help=words)
    return one


def add_report(to: argparse.ArgumentParser) -> None:
    """Figures of a report, and how much is printed."""
    words = "write no figures in --out, only tables, report and data files"
    which = add_figure_format(to)
    which.add_argument("--no-figures", dest="figure_format", action="store_const", const="none", help=words)
    option(to, "--hz", "frequencies in Hz, in figures and tables")
    words = "unit of amplitudes in figures: um, mil, um_pp, mil_pp, ... [um, 0-peak]"
    option(to, "--amplitude UNIT", words, amplitude_word, default=Shown().length)
    option(to, "--interactive", "add Bode plots to the report that can be zoomed and clicked; needs bokeh and some MB")
    add_output(to)


def amplitude_word(text: str) -> str:
    """A unit of amplitudes."""
    name = text.strip().replace("µ", "u").lower()
    if name not in UNITS["displacement"]:
        raise argparse.ArgumentTypeError(unknown_name("unit of amplitudes", text, UNITS["displacement"]))
    return name


def wanted_units(options: argparse.Namespace) -> Shown:
    """Units of figures and tables that were asked for."""
    return Shown(rate="hz" if options.hz else Shown().rate, length=options.amplitude)


def add_group(to: argparse.ArgumentParser) -> None:
    """Which values, of fits with one value of a parameter a condition."""
    option(to, "--at NAME=VALUE ...", "condition, of a fit with parameters per attribute (--per): speed_rpm=1000")


def group(options: argparse.Namespace) -> dict[str, float | str]:
    """The condition that was named."""

    def number_or_text(word: str) -> float | str:
        try:
            return float(word)
        except ValueError:
            return word

    return pairs("--at", options.at, number_or_text)


def add_paths(to: argparse._ActionsContainer, help: str, count: str = "+") -> None:
    """Files, at least one."""
    to.add_argument("files", nargs=count, type=Path, metavar="FILE", help=help)


def add_files(to: argparse._ActionsContainer) -> None:
    """Test files and how they are read."""
    add_paths(to, "test files (.csv .uff .nc .mat), recordings of raw signals (.h5 .tdms .wav)")
    add_setup(to)
    option(to, "--probe-angles PLANE=X:Y ...", "angles of the probes named x and y, degrees from X towards Y")
    words = "subtract each channel's mean reading below this speed (synchronous tests)"
    option(to, "--slow-roll-below RPM", words, float)
    option(to, "--speed RPM", "rotative speed, for universal files without it", float)
    option(to, "--axes AB", "directions of a universal file that are x and y: yz for a shaft along its x [xy]")
    option(to, "--sheet NAME", "sheet of an Excel file [the first]")
    words = (
        "value of a column that a table lacks: force_plane=disk, mr_g_mm=30; for one of several files: "
        "trial.csv:mr_g_mm=30"
    )
    option(to, "--constant [FILE:]COLUMN=VALUE ...", words)
    words = "a column of the file (in a machine's export: a channel) under our name: 'DE X Direct (mil pp)=de_x_mil_pp'"
    option(to, "--column [FILE:]THEIRS=OURS ...", words)
    add_selection(to)
    option(to, "--drop-near-1x PERCENT", "leave out readings this close to the running speed", float)


def add_selection(to: argparse._ActionsContainer) -> None:
    """Which readings to take."""
    rows = "readings by run, speed_rpm, frequency_hz, plane or a column of the file: a value or a range LO:HI"
    option(to, "--where NAME=VALUE ...", f"keep only {rows}; repeat it for a further value")
    option(to, "--exclude NAME=VALUE ...", f"leave out {rows}")
    option(to, "--casing PLANE=CASING ...", "plane of sensors on the casing beside a probe: readings become absolute")
    option(to, "--stator PLANE=KG", "plane of accelerometers on a floating stator, its mass: forces are F - M a")


def add_setup(to: argparse._ActionsContainer) -> None:
    """Setup of the rig for recordings."""
    words = "setup of the rig with the channels of recordings; all files are then recordings"
    option(to, "--setup rig.toml", words, Path)
    words = "reduce recordings by windows of so many turns, for nonlinear rotors"
    option(to, "--windows TURNS", words, count_word)


def add_jobs(to: argparse.ArgumentParser, what: str) -> None:
    """Processes of this machine, or a cluster."""
    option(to, "--jobs N", f"processes to {what} with [%(default)s]", count_word, default=1)
    option(to, "--cluster ADDRESS", f"Dask cluster to {what} with: local:8, or a scheduler's tcp://host:8786")


def add_false_alarm(to: argparse.ArgumentParser, help: str, work: Callable[..., Any]) -> None:
    """Probability of a false alarm, that of the work unless given."""
    option(to, "--false-alarm P", help, probability_word, of=work)


def workers_of(options: argparse.Namespace) -> AbstractContextManager[Executor | None]:
    """An executor of the processes or the cluster that was asked for; None within for this process alone."""
    if options.cluster and options.jobs > 1:
        raise ValueError("--jobs are processes of this machine, --cluster those of a cluster: give one of them")
    if options.cluster:
        return cluster(options.cluster)
    return process_pool(options.jobs) if options.jobs > 1 else nullcontext()


def add_options(to: argparse._ActionsContainer, names: Iterable[str]) -> None:
    """Options from the table; what is not given is ``None``."""
    for one in map(FIT.__getitem__, names):
        shape: dict[str, Any] = {"metavar": one.metavar, "type": one.kind.word}
        if one.kind.word is None:
            shape = {"action": "store_true", "default": None}
        elif one.kind.bare:
            shape |= {"nargs": "?", "const": True}
        elif one.kind.paired:  # read together, when all of them are known
            shape = {"metavar": one.metavar, "action": "append"}
        to.add_argument(one.word, dest=one.name, help=one.help, **shape)
        if one.kind.off:
            to.add_argument(one.kind.off, dest=f"no_{one.name}", action="store_true", help=f"no {one.name} at all")


def add_fit_options(fit: argparse.ArgumentParser) -> None:
    """All that a single fit takes."""
    add_files(fit.add_argument_group("data"))
    apart = (*SHAFT, *SEARCH, *UNCERTAINTY)
    model = fit.add_argument_group("model")
    model.add_argument("--model", help="see `rotorfit models`; left out with --structure")
    add_options(model, [name for name in FIT if name not in apart])
    add_options(fit.add_argument_group("shaft from a file"), SHAFT)
    add_options(fit.add_argument_group("search"), SEARCH)
    add_options(fit.add_argument_group("uncertainty beyond standard errors"), UNCERTAINTY)
    option(fit, "--out OUT", "folder for tables and figures", Path)


# ---- from words to settings -------------------------------------------------------------------


def data_files(options: argparse.Namespace) -> tuple[DataFile | RecordingFiles, ...]:
    """The files of the command line with their read options; recordings together are one test."""
    speed, percent = options.speed, options.drop_near_1x
    if percent is not None and not 0 <= percent < 100:
        raise ValueError(f"--drop-near-1x is per cent of the speed, from 0 to below 100; got {percent:g}")
    given = {
        "probe_angles": pairs("--probe-angles", options.probe_angles, two_numbers),
        "slow_roll_below_rpm": options.slow_roll_below,
        "speed": None if speed is None else speed * RAD_S_PER_RPM,
        "axes": options.axes,
        "sheet": options.sheet,
        "drop_near_1x": None if percent is None else percent / 100,
    }
    read, chosen = {name: value for name, value in given.items() if is_set(value)}, selection(options)
    of_table = _of_table(options)
    raw = tuple(file for file in options.files if options.setup or file.suffix.lower() in ALWAYS_RAW)
    if raw and (read or options.constant or options.column):
        raise ValueError(
            f"{raw[0].name} is a recording: what --probe-angles, --slow-roll-below and --speed say stands in its setup "
            "(--setup rig.toml); --axes, --sheet, --constant, --column and --drop-near-1x are for files of vectors"
        )
    tests = tuple(DataFile(file, read | chosen | of_table[file]) for file in options.files if file not in raw)
    if raw:
        return (*tests, RecordingFiles(paths=raw, setup=options.setup, windows=options.windows, **chosen))
    if options.windows is not None:
        raise ValueError(f"--windows is for recordings of raw signals, which {options.files[0].name} is not")
    return tests


def _of_table(options: argparse.Namespace) -> dict[Path, dict[str, Any]]:
    """Options ``columns`` and ``constants`` of each file: those for all, and those behind its own name."""
    found: dict[Path, dict[str, Any]] = {file: {} for file in options.files}
    for option, name, given in (("--column", "columns", options.column), ("--constant", "constants", options.constant)):
        words = [part for word in given for part in _parts(word)]
        for file, own in _by_file(words, options.files, option).items():
            if own:
                found[file][name] = _named(option, own)
    return found


def _parts(word: str) -> list[str]:
    """Pairs with commas between; a comma within a name of a column, which no equals sign follows before the next comma,
    belongs to it."""
    parts: list[str] = []
    for part in word.split(","):
        if parts and "=" not in parts[-1]:
            parts[-1] += f",{part}"
        else:
            parts.append(part)
    return parts


def _by_file(words: Sequence[str], files: Sequence[Path], option: str) -> dict[Path, list[str]]:
    """Words for each file; ``FILE:`` before one says which it is for."""
    found: dict[Path, list[str]] = {file: [] for file in files}
    for word in map(str.strip, words):
        own = {file: key for file in files for key in (str(file), file.name) if word.startswith(f"{key}:")}
        name, colon, _ = word.partition("=")[0].rpartition(":")
        if colon and not own and (option == "--constant" or Path(name).suffix in {file.suffix for file in files}):
            raise ValueError(
                f"{option} {word}: no file {name.strip()!r} is given; there are "
                f"{', '.join(file.name for file in files)}"
            )
        for file in own or files:
            found[file].append(word.removeprefix(f"{own[file]}:") if own else word)
    return found


def _named(option: str, words: Sequence[str]) -> dict[str, str]:
    """Values by name, which may hold equals signs itself."""
    found: dict[str, str] = {}
    for word in words:
        name, _, value = (part.strip() for part in word.rpartition("="))
        if not (name and value):
            kind = "THEIRS=OURS" if option == "--column" else "COLUMN=VALUE"
            raise ValueError(f"{option} takes {kind}, got {word!r}")
        if name in found:
            raise ValueError(f"{option} names {name} twice")
        found[name] = value
    return found


def selection(options: argparse.Namespace) -> dict[str, Any]:
    """Readings that were chosen, as options of reading."""
    found = {"where": _chosen("--where", options.where), "exclude": _chosen("--exclude", options.exclude)}
    if options.casing:
        found["casing"] = pairs("--casing", options.casing, str)
    if options.stator:
        found["stator"] = pairs("--stator", [options.stator], float)
    return {name: values for name, values in found.items() if values}


def _chosen(option: str, words: Sequence[str]) -> dict[str, Any]:
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
        if name in found and (ends or isinstance(found[name], tuple)):
            raise ValueError(f"{option} {name} is given twice, one of them a range; give one range")
        if ends:
            found[name] = ends
        else:
            found.setdefault(name, []).append(value)
    return found


def _given(options: argparse.Namespace) -> dict[str, Any]:
    """Values of the options that were given, by the names that a study has for them."""
    found: dict[str, Any] = {}
    for one in FIT.values():
        value, parse = getattr(options, one.name), one.kind.word
        if one.kind.off and getattr(options, f"no_{one.name}"):
            if value is not None:
                raise ValueError(f"{one.word} and {one.kind.off} exclude each other")
            found[one.name] = None
        elif value is not None:
            found[one.name] = pairs(one.word, value, parse) if one.kind.paired and parse else value
    return found


def fit_study(options: argparse.Namespace) -> Study:
    """The study that the options of a command describe."""
    if options.model is None and not options.structure:
        raise ValueError("--model is missing: one that `rotorfit models` lists, or --structure with a shaft's file")
    model = options.model or KnownStructure.name
    return Study(files=data_files(options), model=model, out=options.out, **_given(options))


def numbers(text: str) -> Float:
    """Numbers with commas between; ``LO:HI:N`` stands for N of them evenly spaced."""

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
