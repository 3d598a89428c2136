"""``rotorfit store``: tests and fits of machines in one file; add to it, list it, follow it, look for damage."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.cli.answer import Answer
from rotorfit.cli.arguments import (
    add_false_alarm,
    add_jobs,
    add_output,
    add_paths,
    check_false_alarm,
    option,
    workers_of,
)
from rotorfit.cli.progress import progress_line
from rotorfit.cli.trend import place_json
from rotorfit.models.text_table import Wide, text_table
from rotorfit.options.kinds import words

if TYPE_CHECKING:
    from rotorfit.store.records import Added, StoredFit, StoredTest
    from rotorfit.store.store import Store

HELP = "keep tests and their fits in one file: add to it, list it, follow it over time"
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
    add_paths(adding, "test files, recordings, folders with one test's recordings")
    add_study(adding)
    add_jobs(adding, "fit")
    add_output(adding)
    add_output(action("list", _list, "list tests and fits"))
    follow = action("trend", _trend, "report changes of fitted values over time")
    option(follow, "--study STUDY.toml", "settings of the fits [the only ones]", Path)
    add_followed(follow)
    add_false_alarm(follow, "see `rotorfit trend`")
    add_output(follow)
    getting = action("get", _get, "write the result of a fit as fit.json, and its data")
    getting.add_argument("number", type=int, metavar="FIT", help="number of the fit, as `rotorfit store list` shows it")
    help = "folder for fit.json, the tests as netCDF files, and posterior.nc, profiles.csv, bootstrap.csv"
    option(getting, "--out OUT", help, Path, required=True)
    add_output(getting)
    add_output(action("check", _check, "look for damage in every page, test and fit"))


def add_study(to: argparse.ArgumentParser, *, required: bool = False) -> None:
    """The study, the rig, the machine."""
    help = "settings of the fits; its files are patterns of names"
    option(to, "--study STUDY.toml", help, Path, required=required)
    option(to, "--setup rig.toml", "channels of recordings", Path)
    option(to, "--machine NAME", "machine of tests that do not name one", default="")


def add_followed(to: argparse.ArgumentParser) -> None:
    """Quantities that are followed."""
    option(to, "--follow A,B", "values to follow [K0, lam, D, threshold_speed]", words)
    option(to, "--since DATE", "leave out tests before this date", default="")


def answer(options: argparse.Namespace) -> Answer:
    """What the action gives."""
    found: Answer = options.action(options)
    return found


def _opened(options: argparse.Namespace) -> Store:
    from rotorfit.store.store import Store

    if not options.store.exists():
        raise FileNotFoundError(2, "there is no such store", str(options.store))
    return Store(options.store)


def _add(options: argparse.Namespace) -> Answer:
    from rotorfit.store.store import Store

    with progress_line(options) as progress:
        store = Store(options.store)
        with workers_of(options) as executor:
            given = {"machine": options.machine, "setup": options.setup, "progress": progress}
            added = store.add(options.files, options.study, executor=executor, **given)
    fits = {fit.number: fit for fit in store.fits}
    made = [fits[one.fit] for one in added if one.fit is not None]
    refusals = [one.refusal for one in added if one.refusal]
    return Answer(
        text="\n".join(added_words(one, fits) for one in added),
        plain=lambda: [added_json(one, fits) for one in added],
        said=[*refusals, *dict.fromkeys(error for fit in made for error in fit.errors)],
        good=all(fit.good for fit in made),
        refused=bool(refusals),
    )


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
    found: dict[str, Any] = {name: getattr(added, name) for name in ("source", "test", "new_test")}
    found["refusal"] = added.refusal or None
    return found if added.fit is None else {**found, "new_fit": added.new_fit, "fit": fits[added.fit]}


def _list(options: argparse.Namespace) -> Answer:
    store = _opened(options)
    tests, fits = store.tests, store.fits
    return Answer(
        text="\n".join([repr(store)[1:-1], *_table(tests, fits)]), plain=lambda: {"tests": tests, "fits": fits}
    )


def _table(tests: tuple[StoredTest, ...], fits: tuple[StoredFit, ...]) -> list[str]:
    rows: list[list[str | Wide]] = [["test", "date", "machine", "readings", "file"]]
    for test in tests:
        file = Path(test.sources[-1]).name
        more = f" and {len(test.sources) - 1} more" if len(test.sources) > 1 else ""
        state = "" if test.superseded is None else f" (superseded by test {test.superseded})"
        rows.append([str(test.number), test.date, test.machine, str(test.readings), f"{file}{more}{state}"])
        rows += [["", Wide(f"fit {f.number}: {_fit_words(f)}", 4, remark=True)] for f in fits if f.test == test.number]
    return text_table(rows, "<5 <20 <12 >9 <1")


def _trend(options: argparse.Namespace) -> Answer:
    check_false_alarm(options)
    asked = {"study": options.study, "since": options.since, "false_alarm": options.false_alarm}
    found = _opened(options).trend(options.follow, **asked)
    return Answer(text=str(found), plain=lambda: [place_json(place) for place in found.places])


def _get(options: argparse.Namespace) -> Answer:
    from rotorfit.fitting.fit_file import save_fit
    from rotorfit.io.files import write

    store = _opened(options)
    fit = store.result(options.number)

    def fill(folder: Path) -> None:
        save_fit(fit, folder / "fit.json")
        for number, test in enumerate(fit.experiments, 1):
            write(test, folder / f"test{number}.nc")
        for name, data in store.uncertainty_files(options.number).items():
            (folder / name).write_bytes(data)

    return Answer(text=fit.summary(), write=fill, plain=lambda: {"fit": options.number, "out": str(options.out)})


def _check(options: argparse.Namespace) -> Answer:
    problems = _opened(options).problems()
    text = "\n".join(problems) or f"{options.store}: nothing found"
    return Answer(text=text, plain=lambda: problems, refused=bool(problems))
