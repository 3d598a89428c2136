"""``rotorfit simulate``: test a virtual rig and write the file that a test of a real one would give."""

from __future__ import annotations

import argparse
from pathlib import Path

from rotorfit.apps.cli.answer import Answer, answered
from rotorfit.apps.cli.arguments import WRITTEN, WRITTEN_JSON, option
from rotorfit.apps.study_files.folder import complete_folder
from rotorfit.apps.study_files.text import describe_test, test_values
from rotorfit.apps.study_files.virtual_test import read_virtual_test
from rotorfit.identify.diagnosis.check import check
from rotorfit.lab.io.files import check_target, read, write
from rotorfit.lab.simulation.integration import IntegrationError
from rotorfit.lab.simulation.recordings import RECORDED, simulate_recordings
from rotorfit.lab.simulation.simulate import SIMULATED
from rotorfit.lab.simulation.simulate import simulate as simulated


def add_simulate(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    words = "the rotor, its true values and the test as TOML keys; `rotorfit template simulation` prints an example"
    to.add_argument("test", type=Path, metavar="TEST.toml", help=words)
    where = to.add_mutually_exclusive_group(required=True)
    option(where, "--out FILE", WRITTEN, Path)
    option(where, "--recordings DIR", "folder for raw signals in volts, in HDF5, and their rig.toml", Path)
    option(to, "--json", WRITTEN_JSON)
    option(to, "--quiet", "do not say what was written")


@answered
def simulate(options: argparse.Namespace) -> Answer:
    """The file, or the recordings, that a test of a real rig would give."""
    try:
        return _recorded(options) if options.recordings is not None else _written(options)
    except IntegrationError as problem:
        raise ValueError(str(problem)) from problem


def _written(options: argparse.Namespace) -> Answer:
    """A file of vectors, described as any test file is."""
    check_target(options.out)  # before the simulation, which may take long
    write(simulated(**read_virtual_test(options.test, SIMULATED)), options.out)
    if options.quiet and not options.json:
        return Answer(text="")
    test = read(options.out)
    findings = check(test)
    return Answer(text=describe_test(test, findings), plain=lambda: test_values(test, findings))


def _recorded(options: argparse.Namespace) -> Answer:
    """A folder of recordings."""
    settings = read_virtual_test(options.test, RECORDED)
    with complete_folder(options.recordings) as folder:
        names = [file.name for file in simulate_recordings(folder=folder, **settings)]
    files = [str(options.recordings / name) for name in names]
    return Answer(text="\n".join(f"written: {file}" for file in files), plain=lambda: {"written": files})
