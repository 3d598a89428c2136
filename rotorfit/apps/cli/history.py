"""Machines over time: ``rotorfit trend``, and ``store``, which keeps tests and fits in one file."""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path
from typing import Any

from rotorfit.apps.cli.answer import Answer, answered, checked, progress_line
from rotorfit.apps.cli.arguments import (
    add_false_alarm,
    add_files,
    add_jobs,
    add_output,
    add_paths,
    data_files,
    option,
    workers_of,
)
from rotorfit.apps.store.records import Added, StoredFit
from rotorfit.apps.store.store import Store
from rotorfit.apps.study_files.data_files import no_progress, read_files
from rotorfit.base.text_table import Wide, text_table
from rotorfit.identify.fitting.fit_file import load_fit, save_fit
from rotorfit.identify.options.kinds import two_numbers, words
from rotorfit.lab.io.files import write
from rotorfit.lab.io.tables.result_tables import rows_csv
from rotorfit.studies.monitoring.observed_stiffness import observed_stiffness
from rotorfit.studies.monitoring.trend import DatedValues, MachineTrend, PlaceTrend, dated_anisotropy
from rotorfit.studies.monitoring.trend import trend as followed_trend


def add_trend(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_files(to)
    option(to, "--speed-range LO:HI", "speeds to use, rpm; stay below the next critical")
    add_false_alarm(to, "probability of reporting a change when there is none [%(default)g]", followed_trend)
    add_output(to, "trend.csv, summary.txt and trend.png")


@answered
def trend(options: argparse.Namespace) -> Answer:
    """Dated tests of one machine, and what changed."""
    found = _followed(options)
    return Answer(
        text=str(found), files=partial(_trend_files, found), plain=lambda: [place_json(place) for place in found.places]
    )


def _followed(options: argparse.Namespace) -> MachineTrend:
    try:
        limits = two_numbers(options.speed_range) if options.speed_range else None
    except ValueError as problem:
        raise ValueError(f"--speed-range {options.speed_range}: {problem}") from problem
    if all(file.suffix == ".json" for file in options.files):

        def dated(file: Path) -> DatedValues:
            return checked(lambda: dated_anisotropy(load_fit(file)), file)

        return followed_trend([dated(file) for file in options.files], false_alarm=options.false_alarm)
    tests = []
    for test in read_files(data_files(options), no_progress)[0]:
        if (responses := test.perturbation) is None:
            raise ValueError(f"{test.source}: a {test.title} has no observed stiffness: a synchronous test is needed")
        tests += observed_stiffness(responses, speed_rpm=limits)
    return followed_trend(tests, false_alarm=options.false_alarm)


def _trend_files(found: MachineTrend) -> dict[str, Any]:
    from rotorfit.show.plots.style import picture_of

    rows: list[list[Any]] = [["place", "test", "quantity", "unit", "value", "stderr"]]
    for place in found.places:
        for i, date in enumerate(place.dates):
            for j, name in enumerate(place.names):
                rows.append([place.place, date, name, place.units[j], place.values[i, j], place.stderr[i, j]])
    figure = picture_of(found.plot(), dpi=150)
    return {"trend.csv": rows_csv(rows), "summary.txt": f"{found}\n", "trend.png": figure}


def place_json(place: PlaceTrend) -> dict[str, Any]:
    """One place as JSON, SI units."""
    change = place.change
    return {
        "place": place.place,
        "tests": list(place.dates),
        "changed": place.found,
        "p_value": None if change is None else change.p_value,
        "first_after": place.dates[change.index] if change is not None and place.found else None,
        "before": dict(zip(place.names, change.before.tolist(), strict=True)) if change is not None else None,
        "after": dict(zip(place.names, change.after.tolist(), strict=True)) if change is not None else None,
        "causes": [
            {"name": c.name, "change": c.size, "stderr": c.stderr, "probability": c.probability} for c in place.causes
        ],
        "said": place.sentences(),
    }


_EXAMPLES = {
    "add": "add machine.db tests/*.csv --study study.toml",
    "list": "list machine.db",
    "trend": "trend machine.db --study study.toml",
    "get": "get machine.db 3 --out fit-3",
    "refit": "refit machine.db --study study.toml",
    "check": "check machine.db",
}
"""Lines for each action that may be typed as they stand, with files of one's own."""


def add_store(to: argparse.ArgumentParser) -> None:
    """Options of the command."""
    group = to.add_subparsers(metavar="ACTION", required=True)

    def action(name: str, work: Any, help: str) -> argparse.ArgumentParser:
        example = f"Example: rotorfit store {_EXAMPLES[name]}"
        added = group.add_parser(name, help=help, description=help, epilog=example, allow_abbrev=False)
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
    add_false_alarm(follow, "see `rotorfit trend`", Store.trend)
    add_output(follow)
    getting = action("get", _get, "write the result of a fit as fit.json, and its data")
    getting.add_argument("number", type=int, metavar="FIT", help="number of the fit, as `rotorfit store list` shows it")
    help = "folder for fit.json, the tests as netCDF files, and posterior.nc, profiles.csv, bootstrap.csv"
    option(getting, "--out OUT", help, Path, required=True)
    add_output(getting)
    again = action("refit", _refit, "fit again what an earlier rotorfit fitted, whose numbers may be others")
    option(again, "--study STUDY.toml", "settings of the fits", Path, required=True)
    add_jobs(again, "fit")
    add_output(again)
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


@answered
def store(options: argparse.Namespace) -> Answer:
    """What the action gives."""
    found: Answer = options.action(options)
    return found


def _opened(options: argparse.Namespace) -> Store:
    if not options.store.exists():
        raise FileNotFoundError(2, "there is no such store", str(options.store))
    return Store(options.store)


def _add(options: argparse.Namespace) -> Answer:
    with progress_line(options) as progress:
        tests = Store(options.store)
        with workers_of(options) as executor:
            given = {"machine": options.machine, "setup": options.setup, "progress": progress}
            added = tests.add(options.files, options.study, executor=executor, **given)
    fits = {fit.number: fit for fit in tests.fits}
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
    values_shown = 6
    words = ", ".join(f"{name} {value}" for name, value in [*fit.params.items()][-values_shown:])
    return f"{words} (of an earlier rotorfit)" if fit.outdated else words


def added_json(added: Added, fits: dict[int, StoredFit]) -> dict[str, Any]:
    """The outcome for a file, for JSON."""
    found: dict[str, Any] = {name: getattr(added, name) for name in ("source", "test", "new_test")}
    found["refusal"] = added.refusal or None
    return found if added.fit is None else {**found, "new_fit": added.new_fit, "fit": fits[added.fit]}


def _list(options: argparse.Namespace) -> Answer:
    opened = _opened(options)
    tests, fits = opened.tests, opened.fits
    made: dict[int, list[StoredFit]] = {}
    for fit in fits:
        made.setdefault(fit.test, []).append(fit)
    rows: list[list[str | Wide]] = [["test", "date", "machine", "readings", "file"]]
    for test in tests:
        file = Path(test.sources[-1]).name
        more = f" and {len(test.sources) - 1} more" if len(test.sources) > 1 else ""
        state = "" if test.superseded is None else f" (superseded by test {test.superseded})"
        rows.append([str(test.number), test.date, test.machine, str(test.readings), f"{file}{more}{state}"])
        rows += [["", Wide(f"fit {f.number}: {_fit_words(f)}", 4, remark=True)] for f in made.get(test.number, ())]
    table = text_table(rows, "<5 <20 <12 >9 <1")
    return Answer(text="\n".join([repr(opened)[1:-1], *table]), plain=lambda: {"tests": tests, "fits": fits})


def _trend(options: argparse.Namespace) -> Answer:
    asked = {"study": options.study, "since": options.since, "false_alarm": options.false_alarm}
    opened = _opened(options)
    found = opened.trend(options.follow, **asked)
    earlier = sum(fit.outdated for _, fit in opened.history(study=options.study, since=options.since))
    said = [f"{earlier} fits are of an earlier rotorfit: `rotorfit store refit` makes them anew"] if earlier else []
    return Answer(text=str(found), plain=lambda: [place_json(place) for place in found.places], said=said)


def _refit(options: argparse.Namespace) -> Answer:
    with progress_line(options) as progress, workers_of(options) as executor:
        count = _opened(options).refit(options.study, executor=executor, progress=progress)
    return Answer(text=f"{count} fits made anew", plain=lambda: {"fits": count})


def _get(options: argparse.Namespace) -> Answer:
    opened = _opened(options)
    fit = opened.result(options.number)

    kept = opened.uncertainty_files(options.number)
    tests = {f"test{number}.nc": partial(write, test) for number, test in enumerate(fit.experiments, 1)}
    return Answer(
        text=fit.summary(),
        files=lambda: {"fit.json": partial(save_fit, fit), **tests, **kept},
        plain=lambda: {"fit": options.number, "out": str(options.out)},
    )


def _check(options: argparse.Namespace) -> Answer:
    problems = _opened(options).problems()
    text = "\n".join(problems) or f"{options.store}: nothing found"
    return Answer(text=text, plain=lambda: problems, refused=bool(problems))
