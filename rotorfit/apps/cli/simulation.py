"""``rotorfit simulate``: test a virtual rig and write the file that a test of a real one would give."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.apps.cli.answer import Answer, answered
from rotorfit.apps.cli.arguments import add_model, given, model_name, numbers, option
from rotorfit.apps.study_files.folder import complete_folder
from rotorfit.apps.study_files.study import Study, build_model
from rotorfit.apps.study_files.text import describe_test
from rotorfit.base.names import unknown_name
from rotorfit.identify.diagnosis.check import check
from rotorfit.identify.options.kinds import number_word, pairs, whole_word
from rotorfit.identify.options.kinds import words as comma_words
from rotorfit.identify.options.table import LAW, MODEL
from rotorfit.lab.io.files import check_target, read, write
from rotorfit.lab.simulation.instruments import Instruments
from rotorfit.lab.simulation.integration import IntegrationError
from rotorfit.lab.simulation.recordings import RECORDED, simulate_recordings
from rotorfit.lab.simulation.simulate import SIMULATED, options_of
from rotorfit.lab.simulation.simulate import simulate as simulated
from rotorfit.models import RotorModel

_LISTS = {
    "--speed-rpm": "rotative speeds",
    "--frequency-rpm": "perturbation frequencies; negative is backward, see also --backward",
    "--force": "sizes of the rotating force, N",
    "--unbalance": "unbalance m r, kg m, instead of --force; the calibration weight of a synchronous test",
    "--amplitude-um": "radii of an imposed orbit",
    "--load": "constant loads, N",
    "--sweep-rpm": "first and last frequency of a sweep that is recorded",
}
"""Lists of numbers."""
_NUMBERS = {
    "--impulse": ("N_S", "momentum of the blow, N s"),
    "--impulse-deg": ("DEG", "its direction from x towards y [0]"),
    "--duration": ("S", "length of a ring-down record, s"),
    "--sampling-hz": ("HZ", "sampling of a ring-down record"),
    "--turbulence": ("LEVEL", "random force of the flow on every plane in recordings, N per root Hz"),
}
_WORDS = {
    "--plane": "plane of the load, the blow or the imposed orbit [the journal]",
    "--load-plane": "plane of the constant load of a perturbation test [the journal]",
    "--order": "rest, up or down: how a sweep goes through its frequencies [rest]",
}
_NAMES = {word: word[2:].replace("-", "_") for word in (*_LISTS, *_NUMBERS, *_WORDS)} | {"--force-planes": "planes"}
"""Names of the kinds' options in Python."""
_ONE_VALUE = {("perturbation", "load"), ("synchronous", "unbalance")}


def add_simulate(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_model(to, (*MODEL, *LAW))
    option(to, "--set NAME=VALUE ...", "true value of a parameter, SI units")
    option(to, "--kind KIND", "perturbation, static-load, impulse, ... [%(default)s]", default="perturbation")
    for name, words in _LISTS.items():
        option(to, f"{name} A,B|LO:HI:N", words, numbers)
    option(to, "--backward", "add the same frequencies backward")
    option(to, "--load-deg DEG", "direction of the load [%(default)g]", float, default=-90.0)
    for name, (metavar, words) in _NUMBERS.items():
        option(to, f"{name} {metavar}", words, float)
    for name, words in _WORDS.items():
        option(to, f"{name} {name[2:].upper()}", words)
    option(to, "--force-planes A,B", "planes that are forced [all]", comma_words)
    option(to, "--noise NOISE", "noise over the rms reading of a run [%(default)g]", float, default=0.01)
    option(to, "--seed SEED", "of the noise [%(default)s]", whole_word, default=0)
    where = to.add_mutually_exclusive_group(required=True)
    option(where, "--out FILE", "file to write (.csv .uff .nc .mat)", Path)
    option(where, "--recordings DIR", "folder for raw signals in volts, in HDF5, and their rig.toml", Path)
    option(to, "--quiet", "do not say what was written")


@answered
def simulate(options: argparse.Namespace) -> Answer:
    """The file, or the recordings, that a test of a real rig would give."""
    if options.recordings is not None:
        return Answer(text="\n".join(f"written: {options.recordings / name}" for name in _recorded(options)))
    check_target(options.out)  # before the simulation, which may take long
    if options.kind not in SIMULATED:
        raise ValueError(unknown_name("kind of experiment", options.kind, SIMULATED))
    model, params, settings = _model(options), pairs("--set", options.set, number_word), _settings(options)
    _check(options.kind, settings, SIMULATED)
    try:
        test = simulated(model, params, options.kind, noise=options.noise, seed=options.seed, **settings)
    except IntegrationError as problem:
        raise ValueError(str(problem)) from problem
    write(test, options.out)
    if options.quiet:
        return Answer(text="")
    written = read(options.out)
    return Answer(text=describe_test(written, check(written)))


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
    kind = options.kind
    if kind not in RECORDED:
        raise ValueError(unknown_name("kind of recorded test", kind, RECORDED))
    if options.backward:
        raise ValueError("--backward is for files of vectors; recordings are made forward and backward")
    settings = _settings(options)
    instruments = Instruments(sample_rate=settings.pop("sampling_hz", Instruments().sample_rate))
    flow = settings.pop("turbulence", None)
    _check(kind, settings, RECORDED)
    for name, value in settings.items():
        count, numbers = _COUNTS.get((kind, name)), np.atleast_1d(value)
        if count is not None and numbers.size != count:
            word = f"--{name.replace('_', '-')}"
            raise ValueError(f"{word} takes {count} number{'s' * (count > 1)}, got {numbers.size}")
        if count is not None:
            settings[name] = float(numbers[0]) if count == 1 else tuple(numbers.tolist())
    params = pairs("--set", options.set, number_word)
    own = {"instruments": instruments, "seed": options.seed, "turbulence": flow, **settings}
    with complete_folder(options.recordings) as folder:
        return [file.name for file in simulate_recordings(_model(options), params, folder, kind, **own)]


def _check(kind: str, settings: Mapping[str, Any], kinds: Mapping[str, Callable[..., Any]]) -> None:
    """Refuse options that the kind of test does not have, or lacks."""
    needed = options_of(kind, kinds)
    taken = ", ".join(word for word, name in _NAMES.items() if name in needed)
    for word, name in _NAMES.items():
        if name in settings and name not in needed:
            raise ValueError(f"{word}: a test of kind {kind} takes {taken}")
        if needed.get(name) and name not in settings:
            raise ValueError(f"a test of kind {kind} needs {word}; it takes {taken}")


def _model(options: argparse.Namespace) -> RotorModel:
    if options.model == "anisotropic" and not options.planes:
        raise ValueError("anisotropic has as many planes as --planes names: give them")
    study = Study(files=(), model=model_name(options), **given(options, (*MODEL, *LAW)))
    return build_model(study, ())


def _settings(options: argparse.Namespace) -> dict[str, Any]:
    """The options given, by the names that the kinds have for it in Python."""
    named = {name: getattr(options, word[2:].replace("-", "_")) for word, name in _NAMES.items()}
    given = {name: value for name, value in named.items() if value is not None}
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
