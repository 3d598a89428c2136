"""``rotorfit simulate``: test a virtual rig and write the file that a test of a real one would give."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.cli.arguments import add_model, given, model_name, numbers
from rotorfit.options.kinds import number_word, pairs, whole_word, words
from rotorfit.options.table import LAW, MODEL

if TYPE_CHECKING:
    from rotorfit.data.experiments import Experiment
    from rotorfit.models import RotorModel

DESCRIPTION = "simulate a test of a virtual rig by integration in time and write its file"

_LISTS = {
    "--speed-rpm": "rotative speeds",
    "--frequency-rpm": "perturbation frequencies; negative is backward, see also --backward",
    "--force": "sizes of the rotating force, N",
    "--unbalance": "unbalance m r, kg m, instead of --force; the calibration weight of a synchronous test",
    "--amplitude-um": "radii of an imposed orbit",
    "--load": "constant loads, N",
    "--sweep-rpm": "first and last frequency of a sweep that is recorded",
}
"""Lists of numbers, named as the options of the kinds are in Python."""
_NUMBERS = {
    "--impulse": ("N_S", "momentum of the blow, N s"),
    "--impulse-deg": ("DEG", "its direction from x towards y [0]"),
    "--duration": ("S", "length of a ring-down record, s"),
    "--sampling-hz": ("HZ", "sampling of a ring-down record"),
}
_WORDS = {
    "--plane": "plane of the load, the blow or the imposed orbit [the journal]",
    "--load-plane": "plane of the constant load of a perturbation test [the journal]",
    "--order": "rest, up or down: how a sweep goes through its frequencies [rest]",
}
_ONE_VALUE = {("perturbation", "load"), ("synchronous", "unbalance")}


def add_options(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_model(to, (*MODEL, *LAW))
    to.add_argument(
        "--set", action="append", default=[], metavar="NAME=VALUE", help="true value of a parameter, SI units"
    )
    to.add_argument("--kind", default="perturbation", help="perturbation, static-load, impulse, ... [%(default)s]")
    for name, help_text in _LISTS.items():
        to.add_argument(name, type=numbers, metavar="A,B|LO:HI:N", help=help_text)
    to.add_argument("--backward", action="store_true", help="add the same frequencies backward")
    to.add_argument("--load-deg", type=float, default=-90.0, metavar="DEG", help="direction of the load [%(default)g]")
    for name, (metavar, help_text) in _NUMBERS.items():
        to.add_argument(name, type=float, metavar=metavar, help=help_text)
    for name, help_text in _WORDS.items():
        to.add_argument(name, metavar=name[2:].upper(), help=help_text)
    to.add_argument("--force-planes", type=words, metavar="A,B", help="planes that are forced [all]")
    to.add_argument("--noise", type=float, default=0.01, help="noise over the rms reading of a run [%(default)g]")
    to.add_argument("--seed", type=whole_word, default=0, help="of the noise [%(default)s]")
    where = to.add_mutually_exclusive_group(required=True)
    where.add_argument("--out", type=Path, metavar="FILE", help="file to write (.csv .uff .nc .mat)")
    where.add_argument(
        "--recordings", type=Path, metavar="DIR", help="folder for raw signals in volts, in HDF5, and their rig.toml"
    )
    to.add_argument("--quiet", action="store_true", help="do not say what was written")


def run(options: argparse.Namespace) -> int:
    """Do what the command line says; returns the exit code."""
    from rotorfit.cli.errors import BadInputError, ExitCode, checked
    from rotorfit.diagnosis.check import check
    from rotorfit.io.files import read, write
    from rotorfit.simulation.integration import IntegrationError
    from rotorfit.studies.text import describe_test
    from rotorfit.studies.wording import sentence

    if options.recordings is not None:
        names = checked(lambda: _recorded(options))
        if not options.quiet:
            print("\n".join(f"written: {options.recordings / name}" for name in names))
        return ExitCode.DONE
    try:
        test = checked(lambda: _simulated(options))
    except IntegrationError as problem:
        raise BadInputError(sentence(problem)) from problem
    checked(lambda: write(test, options.out))
    if not options.quiet:
        written = checked(lambda: read(options.out))
        print(f"{describe_test(written, check(written))}\n\nwritten to {options.out}")
    return ExitCode.DONE


def _simulated(options: argparse.Namespace) -> Experiment:
    from rotorfit.io.files import SUFFIXES
    from rotorfit.models.parameters import unknown_name
    from rotorfit.simulation.options import check_options
    from rotorfit.simulation.simulate import SIMULATED, simulate

    if options.out.suffix.lower() not in SUFFIXES:  # before the simulation, which may take long
        raise ValueError(f"--out {options.out.name}: {unknown_name('suffix', options.out.suffix, SUFFIXES)}")
    if not options.out.parent.is_dir():
        raise FileNotFoundError(f"cannot write {options.out}: there is no folder {options.out.parent}")
    if options.kind not in SIMULATED:
        raise ValueError(unknown_name("kind of experiment", options.kind, SIMULATED))
    model, params = _model(options), pairs("--set", options.set, number_word)
    settings = _settings(options)
    try:
        check_options(options.kind, settings, SIMULATED)
    except TypeError as problem:
        raise ValueError(str(problem)) from problem
    return simulate(model, params, options.kind, noise=options.noise, seed=options.seed, **settings)


_COUNTS = {
    ("perturbation", "sweep_rpm"): 2,
    ("perturbation", "unbalance"): 1,
    ("dwell", "unbalance"): 1,
    ("synchronous", "speed_rpm"): 2,
    ("synchronous", "unbalance"): 1,
    ("balance", "unbalance"): 1,
    ("measured-force", "sweep_rpm"): 2,
    ("measured-force", "speed_rpm"): 1,
    ("measured-force", "force"): 1,
    ("release", "load"): 1,
}
"""How many numbers an option of a recorded test takes, where that is fixed."""


def _recorded(options: argparse.Namespace) -> list[str]:
    """Names of the recordings that were written."""
    from inspect import signature

    import numpy as np

    from rotorfit.models.parameters import unknown_name
    from rotorfit.simulation.instruments import Instruments
    from rotorfit.simulation.recordings import RECORDED, simulate_recordings
    from rotorfit.studies.folder import complete_folder

    kind = options.kind
    if kind not in RECORDED:
        raise ValueError(unknown_name("kind of recorded test", kind, RECORDED))
    if options.backward:
        raise ValueError("--backward is for files of vectors; recordings are made forward and backward")
    known = [name for name in signature(RECORDED[kind]).parameters if name != "rig"]
    settings = _settings(options)
    instruments = Instruments(sample_rate=settings.pop("sampling_hz", Instruments().sample_rate))
    for name, value in settings.items():
        word = f"--{name.replace('_', '-')}"
        if name not in known:
            raise ValueError(f"{word}: recordings of kind {kind} take {', '.join(known)}")
        count, numbers = _COUNTS.get((kind, name)), np.atleast_1d(value)
        if count is not None and numbers.size != count:
            raise ValueError(f"{word} takes {count} number{'s' * (count > 1)}, got {numbers.size}")
        if count is not None:
            settings[name] = float(numbers[0]) if count == 1 else tuple(numbers.tolist())
    params = pairs("--set", options.set, number_word)
    model = _model(options)
    try:
        with complete_folder(options.recordings) as folder:
            files = simulate_recordings(
                model, params, folder, kind, instruments=instruments, seed=options.seed, **settings
            )
            return [file.name for file in files]
    except TypeError as problem:  # an option that the kind needs
        raise ValueError(str(problem)) from problem


def _model(options: argparse.Namespace) -> RotorModel:
    from rotorfit.studies.study import Study
    from rotorfit.studies.study_model import build_model

    if options.model == "anisotropic" and not options.planes:
        raise ValueError("anisotropic has as many planes as --planes names: give them")
    study = Study(files=(), model=model_name(options), **given(options, (*MODEL, *LAW)))
    return build_model(study, ())


def _settings(options: argparse.Namespace) -> dict[str, Any]:
    """The options given, by the names that the kinds have for it in Python."""
    import numpy as np

    names = [name[2:].replace("-", "_") for name in (*_LISTS, *_NUMBERS, *_WORDS)]
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    if options.force_planes is not None:
        given["planes"] = options.force_planes
    if options.backward:
        if "frequency_rpm" not in given:
            raise ValueError("--backward turns frequencies around: give --frequency-rpm")
        given["frequency_rpm"] = np.concatenate([-given["frequency_rpm"][::-1], given["frequency_rpm"]])
    for name in (one for kind, one in _ONE_VALUE if kind == options.kind and one in given):
        if len(given[name]) != 1:
            raise ValueError(f"--{name} of a {options.kind} test takes one value, got {len(given[name])}")
        given[name] = float(given[name][0])
    if "load" in given and options.kind == "perturbation":
        given["load"] *= np.exp(1j * np.radians(options.load_deg))
    elif "load" in given:
        given["load_deg"] = options.load_deg
    return given
