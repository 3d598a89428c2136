"""The store: tests by their content, fits by their settings, each once, whoever adds them and whatever is killed."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from rotorfit.apps.store.adding import add_sources, refit
from rotorfit.apps.store.database import KIND, Database, unpacked
from rotorfit.apps.store.records import (
    Added,
    StoredFit,
    StoredTest,
    StoredValue,
    differing,
    odd_in_fit,
    of_its_test,
    rightly_superseded,
    said_by,
    stored_fit,
    stored_test,
)
from rotorfit.apps.store.sources import key_of, settings_key, sources_of
from rotorfit.apps.study_files.data_files import StudyProgress, no_progress
from rotorfit.apps.study_files.results import UNCERTAINTY_FILES
from rotorfit.apps.study_files.study import Study, check_model
from rotorfit.apps.study_files.study_file import read_study, study_of
from rotorfit.base.atomic_file import note_input, refuse_input
from rotorfit.base.file_reading import reading, shown, shown_within
from rotorfit.base.names import unknown_name
from rotorfit.identify.fitting.fit_file import fit_from_json
from rotorfit.identify.fitting.json_values import decode
from rotorfit.identify.fitting.quantities import THRESHOLD
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.data.rows import Experiment
from rotorfit.models import RotorModel
from rotorfit.studies.monitoring.trend import DatedValues, MachineTrend, as_time, trend

if TYPE_CHECKING:
    from rotorfit.identify.uncertainty.posterior import Posterior

_FOLLOWED = ("K0", "lam", "lam_D", "D", THRESHOLD)
"""Values that are followed unless others are named, where a fit has them."""


class Store:
    """Tests and fits of one machine or of many, in one SQLite file.

    The same test with the same settings is fitted once, whoever adds it and from whichever file. Any number of
    processes may write at a time; one that is killed leaves what it had added, whole, and nothing of the rest.

    Args:
        path: the file, made where there is none.

    Raises:
        ValueError: another file, a damaged one, or one that a newer version wrote.
        OSError: no such folder, or one that may not be written to.

    Attributes:
        path: the file.
        database: its tables.

    Example:
        >>> store = rf.Store(folder / "machine.db")
        >>> file = rf.datasets.path("rig_lumped.csv")
        >>> [added] = store.add([file], study={"model": "whirl-whip", "known": {"K3": 6000.0}})
        >>> print(store.fits[0].params["lam"])
        0.4758 +- 0.0039
        >>> store.add([file], study={"model": "whirl-whip", "known": {"K3": 6000.0}})[0].new_fit
        False
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        refuse_input(self.path)
        self.database = Database(self.path)
        note_input(self.path)

    def __repr__(self) -> str:
        with self.database.look() as ask:
            tests, fits = (ask(f"SELECT count(*) FROM {table}")[0][0] for table in ("tests", "fits"))
        return f"<Store {self.path}: {tests} test{'s' * (tests != 1)}, {fits} fit{'s' * (fits != 1)}>"

    # ---- adding --------------------------------------------------------------------------------------------------

    def add(
        self,
        files: Iterable[str | os.PathLike[str]],
        study: str | os.PathLike[str] | Mapping[str, Any] | Study | None = None,
        *,
        machine: str = "",
        setup: str | os.PathLike[str] | None = None,
        executor: Executor | None = None,
        progress: StudyProgress = no_progress,
    ) -> tuple[Added, ...]:
        """Add tests, and with a study their fits.

        Args:
            files: test files, one test each; recordings; folders with the recordings of one test.
            study: settings of the fits: a TOML file, or its keys as a mapping. Its ``files``, which may be left out,
                are patterns of names with the options to read such files with.
            machine: the machine of tests that have no attribute ``machine``.
            setup: ``rig.toml`` for recordings.
            executor: any ``concurrent.futures`` executor, also Dask's ``client.get_executor(pure=False)``, to fit with;
                by default one fit is made after the other, here.
            progress: called as each stage begins.

        Returns:
            what became of each file; one that cannot be read is refused, the others are added.

        Raises:
            ValueError: a study that is wrong.
            OSError: a store that cannot be written.
        """
        settings = study_for_store(study)
        rig = None if setup is None else Path(setup)
        sources = sources_of([Path(file) for file in files], settings, rig, progress)
        return add_sources(self, sources, machine, executor, progress)

    def refit(
        self,
        study: str | os.PathLike[str] | Mapping[str, Any] | Study,
        *,
        executor: Executor | None = None,
        progress: StudyProgress = no_progress,
    ) -> int:
        """Make fits anew whose numbers are of another version of rotorfit's results; see ``StoredFit.outdated``.

        Args:
            study: settings of the fits.
            executor: any ``concurrent.futures`` executor to fit with.
            progress: called as each fit begins.

        Returns:
            how many were made.

        Raises:
            ValueError: a study that is wrong.
            OSError: a store that cannot be written.
        """
        settings = study_for_store(study)
        return 0 if settings is None else refit(self, settings, executor, progress)

    # ---- asking --------------------------------------------------------------------------------------------------

    @property
    def tests(self) -> tuple[StoredTest, ...]:
        """All tests in order of arrival, superseded ones included."""
        with self.database.look() as ask:
            rows = ask(
                "SELECT number, batch, content, kind, readings, machine, date, date_given, conditions, findings, "
                "superseded FROM tests ORDER BY number"
            )
            paths: dict[int, list[str]] = {}
            for test, path in ask("SELECT DISTINCT test, path FROM sources WHERE test NOT NULL ORDER BY number"):
                paths.setdefault(test, []).append(path)
        with reading(str(self.path), KIND, decoded=True):
            if lost := [row["number"] for row in rows if row["number"] not in paths]:
                raise ValueError(f"{self.path} is damaged: nothing says where test {lost[0]} came from")
            return tuple(stored_test(dict(row), paths[row["number"]]) for row in rows)

    @property
    def fits(self) -> tuple[StoredFit, ...]:
        """All fits in order of their making."""
        with self.database.look() as ask:
            rows = ask(
                "SELECT number, test, model, settings, success, message, redchi, findings, version, results "
                "FROM fits JOIN settings ON key = settings ORDER BY number"
            )
            parameters = ask("SELECT * FROM parameters")
        with reading(str(self.path), KIND, decoded=True):
            values: dict[int, dict[str, StoredValue]] = {}
            for fit, name, *numbers, unit in parameters:
                value, stderr, systematic = (math.nan if number is None else float(number) for number in numbers)
                stored = StoredValue(value=value, stderr=stderr, systematic=systematic, unit=shown(unit))
                values.setdefault(fit, {})[name] = stored
            return tuple(stored_fit(dict(row), values.get(row["number"], {})) for row in rows)

    @property
    def refused(self) -> dict[str, str]:
        """Files that could not be read and have not been read since, with the reason."""
        with self.database.look() as ask:
            rows = ask("SELECT path, test, refusal FROM sources ORDER BY number")
        latest = {path: (test, refusal) for path, test, refusal in rows}
        found: dict[str, str] = shown_within(
            {path: refusal for path, (test, refusal) in latest.items() if test is None}
        )
        return found

    def experiments(self, test: int) -> tuple[Experiment, ...]:
        """The readings of a test.

        Args:
            test: its number.

        Raises:
            KeyError: no such test.
            ValueError: it is damaged.
        """
        text = self._blob("SELECT data FROM tests WHERE number = ?", test, "test")
        with reading(f"test {test} of {self.path}", KIND, decoded=True):
            return tuple(decode(json.loads(text)))

    def result(self, fit: int, *, model: RotorModel | None = None) -> FitResult:
        """The whole result of a fit, to be plotted, sampled and judged as any other.

        Args:
            fit: its number.
            model: the model, needed if it is one of your own.

        Raises:
            KeyError: no such fit, or one that could not be made.
            ValueError: it is damaged.
        """
        text = self._blob("SELECT result FROM fits WHERE number = ?", fit, "fit")
        return fit_from_json(text, model=model, source=f"fit {fit} of {self.path}")

    def posterior(self, fit: int) -> Posterior:
        """The posterior of a fit whose study has ``sample = true``.

        Args:
            fit: its number.

        Raises:
            KeyError: no such fit, or one without a posterior.
            ValueError: it is damaged.
        """
        from rotorfit.identify.uncertainty.posterior_file import load_posterior

        result, found = self.result(fit), self.uncertainty_files(fit)
        if "posterior.nc" not in found:
            raise KeyError(f"fit {fit} of {self.path} has no posterior: sample = true in its study draws one")
        with TemporaryDirectory() as folder:
            path = Path(folder) / f"posterior of fit {fit}.nc"
            path.write_bytes(found["posterior.nc"])
            return load_posterior(path, result)

    def uncertainty_files(self, fit: int) -> dict[str, bytes]:
        """Content of the files that the study of a fit asks for: ``posterior.nc``, ``profiles.csv``, ``bootstrap.csv``.

        Args:
            fit: its number.

        Raises:
            ValueError: the store holds others, which rotorfit did not write.
        """
        with self.database.look() as ask:
            found = dict(ask("SELECT file, data FROM uncertainty WHERE fit = ?", (fit,)))
        for name, data in found.items():
            if name not in UNCERTAINTY_FILES or not isinstance(data, bytes):
                raise ValueError(f"fit {fit} of {self.path} has a file {str(name)[:80]!a}, which no fit has: damaged")
        return found

    def _blob(self, sql: str, number: int, what: str) -> str:
        with self.database.look() as ask:
            rows = ask(sql, (number,))
        if not rows or rows[0][0] is None:
            raise KeyError(f"{self.path} holds no {what} {number}")
        return unpacked(rows[0][0], f"{what} {number} of {self.path}")

    def history(
        self,
        *,
        study: str | os.PathLike[str] | Mapping[str, Any] | Study | None = None,
        machine: str | None = None,
        since: str = "",
    ) -> tuple[tuple[StoredTest, StoredFit], ...]:
        """Tests that count with their fits by one study, in order of arrival, those that came together by date.

        Args:
            study: settings of the fits; by default the only ones in the store.
            machine: only tests of this one.
            since: date, ISO 8601, from which on tests count.

        Raises:
            ValueError: fits by several settings, of which none is chosen, or a date that cannot be read.
            KeyError: no such machine.
        """
        given = study_for_store(study)
        if given is None:
            with self.database.look() as ask:
                rows = ask("SELECT key, text FROM settings")
            if len(rows) > 1:
                texts = "; ".join(shown(text) for _, text in rows[:4])
                raise ValueError(f"{self.path} holds fits by {len(rows)} settings, say which (study): {texts}")
        key = settings_key(given)[0] if given is not None else str(rows[0][0]) if rows else ""
        first = as_time(since, "since") if since else None
        tests = {test.number: test for test in self.tests if test.superseded is None}
        machines = sorted({test.machine for test in tests.values()})
        if machine is not None and machine not in machines:
            raise KeyError(unknown_name("machine", machine, machines))
        pairs = [(tests[fit.test], fit) for fit in self.fits if fit.settings == key and fit.test in tests]
        return tuple(
            (test, fit)
            for test, fit in sorted(pairs, key=lambda pair: (pair[0].batch, pair[0].date, pair[0].number))
            if machine in (None, test.machine) and (first is None or as_time(test.date, test.sources[0]) >= first)
        )

    def trend(
        self,
        names: str | Sequence[str] | None = None,
        *,
        study: str | os.PathLike[str] | Mapping[str, Any] | Study | None = None,
        machine: str | None = None,
        since: str = "",
        false_alarm: float = 0.01,
    ) -> MachineTrend:
        """Follow fitted values over the dates of the tests, machine by machine; see :func:`rotorfit.trend`.

        Fits that did not converge, and those of data with errors, are left out.

        Args:
            names: parameters, ``threshold_speed`` among them; by default K0, lam, D and that, where fits have them.
            study: settings of the fits; by default the only ones in the store.
            machine: only tests of this one.
            since: date, ISO 8601, from which on tests count.
            false_alarm: probability of finding a change in any machine where there is none.

        Raises:
            ValueError: no fit to follow, or values that the fits do not have.
        """
        entries = []
        for test, fit in self.history(study=study, machine=machine, since=since):
            if fit.good:
                chosen = {name: fit.params[name] for name in followed(names, fit)}
                values = {name: (value.value, value.scatter) for name, value in chosen.items()}
                units = {name: value.unit for name, value in chosen.items()}
                source = test.sources[0]
                entries.append(
                    DatedValues(date=test.date, values=values, units=units, place=test.machine, source=source)
                )
        if not entries:
            raise ValueError(f"{self.path} holds no fit to follow: none converged on data without errors")
        return trend(entries, false_alarm=false_alarm)

    def find(self, keys: Sequence[str]) -> dict[str, bytes]:
        """Pieces of work that :meth:`keep` kept, of a campaign for instance, as far as they are there.

        Args:
            keys: of the pieces.
        """
        with self.database.look() as ask:
            rows = (ask("SELECT key, data FROM pieces WHERE key = ?", (key,)) for key in keys)
            return {found[0][0]: found[0][1] for found in rows if found}

    def keep(self, pieces: Mapping[str, bytes]) -> None:
        """Keep pieces of work that is under way, for whoever begins it again; all of them or none.

        Args:
            pieces: by their keys.
        """
        with self.database.change() as connection:
            connection.executemany("INSERT OR IGNORE INTO pieces VALUES (?, ?)", list(pieces.items()))

    def problems(self) -> tuple[str, ...]:
        """Damage of the store: every page and record, every test against its readings, every fit against its result."""
        found = self.database.problems()
        with self.database.look() as ask:
            settings = ask("SELECT key, text FROM settings")
            never = ask("SELECT fit FROM alarms WHERE fit > (SELECT coalesce(max(seq), 0) FROM sqlite_sequence)")
            whole = {row[0] for row in ask("SELECT number FROM fits WHERE result NOT NULL")}
        texts = dict(map(tuple, settings))
        found += [
            f"settings: {text!r} are not those of their key" for key, text in texts.items() if key != key_of(text)
        ]
        found += [f"alarms: one was told of fit {fit}, which has never been made" for (fit,) in never]
        try:
            tests, fits = self.tests, self.fits
        except ValueError as problem:
            return tuple(map(shown, (*found, str(problem))))
        by_number = {test.number: test for test in tests}
        if sorted(tests, key=lambda test: test.batch) != list(tests):
            found.append("tests: they are not in the order of their arrival")
        found += [
            f"test {test.number}: it counts no longer, and no later state of its files takes its place"
            for test in tests
            if not rightly_superseded(test, by_number)
        ]
        for test in tests:
            try:
                odd = differing(test, said_by(self.experiments(test.number), self.path.name))
            except ValueError as problem:
                found.append(str(problem))
            else:
                found += [f"test {test.number}: its readings are not those that were added"] * ("content" in odd)
                other = ", ".join(name for name in odd if name != "content")
                found += [f"test {test.number}: {other} are not those of its readings"] * bool(other)
        for fit in fits:
            try:
                self.uncertainty_files(fit.number)
                result = self.result(fit.number) if fit.number in whole else None
                odd = odd_in_fit(fit, result)
                its = by_number.get(fit.test)
                is_its = result is None or its is None or of_its_test(result, its, texts[fit.settings])
            except ValueError as problem:
                found.append(str(problem))
            else:
                found += [f"fit {fit.number}: {', '.join(odd)} differ from the result"] * bool(odd)
                found += [f"fit {fit.number}: it is of other readings than test {fit.test}"] * (not is_its)
        return tuple(map(shown, found))


def study_for_store(study: str | os.PathLike[str] | Mapping[str, Any] | Study | None) -> Study | None:
    """A study by its file, its keys, or itself."""
    if study is None:
        return None
    if isinstance(study, Study):
        found = study
    elif isinstance(study, Mapping):
        found = study_of(study, of_a_store=True)
    else:
        found = read_study(Path(study), of_a_store=True)
    check_model(found)
    return found


def followed(names: str | Sequence[str] | None, fit: StoredFit) -> tuple[str, ...]:
    """Names of the values of a fit that are followed: those asked for, else those of the fluid, else all."""
    has = [name for name, value in fit.params.items() if value.stderr > 0 and math.isfinite(value.stderr)]
    if names is None:
        return tuple(name for name in _FOLLOWED if name in has) or tuple(has)
    asked = (names,) if isinstance(names, str) else tuple(names)
    for name in asked:
        if name not in fit.params:
            raise ValueError(unknown_name("value of the fits", name, list(fit.params)))
    return tuple(name for name in asked if name in has)
