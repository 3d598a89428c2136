"""``rotorfit store``: tests and fits of machines in one file; add to it, list it, follow it, look for damage."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.cli.answer import say
from rotorfit.cli.arguments import add_jobs, add_output, workers_of
from rotorfit.cli.progress import ProgressLine
from rotorfit.models.text_table import Wide, text_table
from rotorfit.options.kinds import positive_word, words
from rotorfit.studies.json_text import json_text

if TYPE_CHECKING:
    from rotorfit.store.records import Added, StoredFit, StoredTest
    from rotorfit.store.store import Store

DESCRIPTION = "keep tests and their fits in one file: add to it, list it, follow it over time"
_VALUES_SHOWN = 6


def add_options(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    group = to.add_subparsers(metavar="ACTION", required=True)

    def action(name: str, work: Any, help: str) -> argparse.ArgumentParser:
        added = group.add_parser(name, help=help, description=help, allow_abbrev=False)
        added.set_defaults(action=work)
        added.add_argument("store", type=Path, metavar="STORE", help="the file, machine.db for instance")
        return added

    adding = action("add", _add, "add test files and fit them with the settings of a study; nothing is fitted twice")
    adding.add_argument(
        "files", nargs="+", type=Path, metavar="FILE", help="test files, recordings, folders with one test's recordings"
    )
    add_study(adding)
    add_jobs(adding, "fit")
    add_output(adding)
    add_output(action("list", _list, "list tests and fits"))
    follow = action("trend", _trend, "report changes of fitted values over time")
    follow.add_argument("--study", type=Path, metavar="STUDY.toml", help="settings of the fits [the only ones]")
    add_followed(follow)
    follow.add_argument("--false-alarm", type=positive_word, default=0.01, metavar="P", help="see `rotorfit trend`")
    add_output(follow)
    getting = action("get", _get, "write the result of a fit as fit.json, and its data")
    getting.add_argument("number", type=int, metavar="FIT", help="number of the fit, as `rotorfit store list` shows it")
    getting.add_argument(
        "--out",
        type=Path,
        required=True,
        help="folder for fit.json, the tests as netCDF files, and posterior.nc, profiles.csv, bootstrap.csv",
    )
    add_output(getting)
    add_output(action("check", _check, "look for damage in every page, test and fit"))


def add_study(to: argparse.ArgumentParser, *, required: bool = False) -> None:
    """The study, the rig, the machine."""
    to.add_argument(
        "--study", type=Path, metavar="STUDY.toml", required=required, help="settings of the fits; its files are "
        "patterns of names",
    )  # fmt: skip
    to.add_argument("--setup", type=Path, metavar="rig.toml", help="channels of recordings")
    to.add_argument("--machine", default="", metavar="NAME", help="machine of tests that do not name one")


def add_followed(to: argparse.ArgumentParser) -> None:
    """Quantities that are followed."""
    to.add_argument("--follow", type=words, metavar="A,B", help="values to follow [K0, lam, D, threshold_speed]")
    to.add_argument("--since", default="", metavar="DATE", help="leave out tests before this date")


def run(options: argparse.Namespace) -> int:
    """Do what the command line says; returns the exit code."""
    return int(options.action(options))


def _opened(options: argparse.Namespace, *, there: bool = True) -> Store:
    from rotorfit.store.store import Store

    if there and not options.store.exists():
        raise FileNotFoundError(2, "there is no such store", str(options.store))
    return Store(options.store)


def _add(options: argparse.Namespace) -> int:
    from rotorfit.cli.errors import ExitCode, checked

    line = ProgressLine(enabled=not options.quiet and sys.stderr.isatty())
    try:
        store, added = checked(lambda: _added(options, line))
    finally:
        line.close()
    fits = {fit.number: fit for fit in checked(lambda: store.fits)}
    if options.json:
        print(json_text([added_json(one, fits) for one in added]))
    elif not options.quiet:
        print("\n".join(added_words(one, fits) for one in added))
    for one in added:
        if one.refusal:
            say(one.refusal)
    wrong = [error for one in added if one.fit is not None for error in fits[one.fit].errors]
    for error in dict.fromkeys(wrong):
        say(error)
    if any(one.refusal for one in added):
        return ExitCode.BAD_INPUT
    failed = any(not fits[one.fit].good for one in added if one.fit is not None)
    return ExitCode.NOT_CONVERGED if failed else ExitCode.DONE


def _added(options: argparse.Namespace, progress: ProgressLine) -> tuple[Store, tuple[Added, ...]]:
    store = _opened(options, there=False)
    with workers_of(options) as executor:
        words = {"machine": options.machine, "setup": options.setup, "executor": executor, "progress": progress}
        return store, store.add(options.files, options.study, **words)


def added_words(added: Added, fits: dict[int, StoredFit]) -> str:
    """The outcome for a file, on a line."""
    if added.test is None:
        return f"{added.source}: refused"
    head = f"{added.source}: test {added.test}{'' if added.new_test else ', known already'}"
    if added.fit is None:
        return head
    fit = fits[added.fit]
    return f"{head}; fit {fit.number}{'' if added.new_fit else ', known already'}: {_fit_words(fit)}"


def _fit_words(fit: StoredFit) -> str:
    if not fit.params:
        return f"not fitted: {fit.message}"
    if fit.errors:
        return "the data have an error, the fit is not followed"
    if not fit.success:
        return f"did not converge: {fit.message}"
    return ", ".join(f"{name} {value}" for name, value in [*fit.params.items()][-_VALUES_SHOWN:])


def added_json(added: Added, fits: dict[int, StoredFit]) -> dict[str, Any]:
    """The outcome for a file, for JSON."""
    found: dict[str, Any] = {
        "source": added.source,
        "test": added.test,
        "new_test": added.new_test,
        "refusal": added.refusal or None,
    }
    return found if added.fit is None else {**found, "new_fit": added.new_fit, "fit": fits[added.fit]}


def _list(options: argparse.Namespace) -> int:
    from rotorfit.cli.errors import ExitCode, checked

    store = checked(lambda: _opened(options))
    tests, fits = checked(lambda: (store.tests, store.fits))
    if options.json:
        print(json_text({"tests": tests, "fits": fits}))
    elif not options.quiet:
        print("\n".join([repr(store)[1:-1], *_table(tests, fits)]))
    return ExitCode.DONE


def _table(tests: tuple[StoredTest, ...], fits: tuple[StoredFit, ...]) -> list[str]:
    rows: list[list[str | Wide]] = [["test", "date", "machine", "readings", "file"]]
    for test in tests:
        file = Path(test.sources[-1]).name
        more = f" and {len(test.sources) - 1} more" if len(test.sources) > 1 else ""
        state = "" if test.superseded is None else f" (superseded by test {test.superseded})"
        rows.append([str(test.number), test.date, test.machine, str(test.readings), f"{file}{more}{state}"])
        rows += [["", Wide(f"fit {f.number}: {_fit_words(f)}", 4, remark=True)] for f in fits if f.test == test.number]
    return text_table(rows, "<5 <20 <12 >9 <1")


def _trend(options: argparse.Namespace) -> int:
    from rotorfit.cli.errors import ExitCode, checked
    from rotorfit.cli.trend import place_json

    if options.false_alarm >= 1:
        checked(lambda: _refuse_probability(options.false_alarm))
    found = checked(
        lambda: _opened(options).trend(
            options.follow, study=options.study, since=options.since, false_alarm=options.false_alarm
        )
    )
    if options.json:
        print(json_text([place_json(place) for place in found.places]))
    elif not options.quiet:
        print(found)
    return ExitCode.DONE


def _refuse_probability(given: float) -> None:
    raise ValueError(f"--false-alarm takes a probability below 1, got {given:g}")


def _get(options: argparse.Namespace) -> int:
    from rotorfit.cli.answer import give
    from rotorfit.cli.errors import ExitCode, checked
    from rotorfit.fitting.fit_file import save_fit
    from rotorfit.io.files import write

    store = checked(lambda: _opened(options))
    fit = checked(lambda: store.result(options.number))

    def fill(folder: Path) -> None:
        save_fit(fit, folder / "fit.json")
        for number, test in enumerate(fit.experiments, 1):
            write(test, folder / f"test{number}.nc")
        for name, data in store.uncertainty_files(options.number).items():
            (folder / name).write_bytes(data)

    give(options, fill, lambda: {"fit": options.number, "out": str(options.out)}, fit.summary())
    return ExitCode.DONE


def _check(options: argparse.Namespace) -> int:
    from rotorfit.cli.errors import ExitCode, checked

    problems = checked(lambda: _opened(options).problems())
    if options.json:
        print(json_text(problems))
    elif not options.quiet:
        print("\n".join(problems) or f"{options.store}: nothing found")
    return ExitCode.BAD_INPUT if problems else ExitCode.DONE
