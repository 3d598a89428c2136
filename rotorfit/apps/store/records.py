"""Records of a store, tests, fits, and the outcome for a file; as rows of the tables, and back."""

from __future__ import annotations

import json
import math
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from datetime import datetime
from typing import Any, TypeVar

from rotorfit.apps.store.database import packed
from rotorfit.apps.store.sources import Source
from rotorfit.apps.study_files.data_files import StudyProgress
from rotorfit.apps.study_files.study import Outcome
from rotorfit.base.digits import plus_minus
from rotorfit.base.file_reading import shown_within
from rotorfit.base.version import RESULTS, __version__
from rotorfit.base.written_units import shown_unit
from rotorfit.identify.fitting.fit_file import fit_to_json
from rotorfit.identify.fitting.json_values import encode
from rotorfit.identify.fitting.quantities import THRESHOLD
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.data.content import content_hash
from rotorfit.lab.data.findings import Finding, errors_in, warnings_in
from rotorfit.lab.data.rows import Experiment
from rotorfit.studies.campaigns.runs import conditions
from rotorfit.studies.monitoring.trend import as_time

Record = TypeVar("Record", "StoredTest", "StoredFit")


@dataclass(frozen=True, kw_only=True)
class StoredValue:
    """A parameter of a stored fit, SI units."""

    value: float  # estimate, NaN where the data do not determine it
    stderr: float  # its standard error
    systematic: float  # share of it on trust: sizes of causes, which the tests of a machine have in common
    unit: str  # SI unit

    @property
    def scatter(self) -> float:
        """What differs from test to test: the noise, and causes that each test finds anew."""
        return math.sqrt(max((self.stderr - self.systematic) * (self.stderr + self.systematic), 0.0))

    def __str__(self) -> str:
        if not math.isfinite(self.value):
            return "not determined"
        return f"{plus_minus(self.value, self.stderr)} {shown_unit(self.unit)}".rstrip()


@dataclass(frozen=True, kw_only=True)
class StoredTest:
    """A test in a store."""

    number: int  # by which the store knows it, in order of arrival
    batch: int  # the same of tests that were added together
    content: str  # hash of its readings
    kind: str  # what was measured
    readings: int  # how many
    machine: str  # the machine, by the attribute ``machine`` of the data or as it was added; may be empty
    date: str  # ISO 8601, by the attribute ``date`` of the data, else the time of the file
    date_given: bool  # whether the data give it
    conditions: Mapping[str, float | str]  # attributes: the mean of numbers, the text of texts
    sources: tuple[str, ...]  # files and folders it was found in
    findings: tuple[str, ...]  # errors and warnings of the check of the data
    superseded: int | None  # number of the later test that holds the same files, completed; none where this one counts


@dataclass(frozen=True, kw_only=True)
class StoredFit:
    """A fit in a store; :meth:`Store.result` gives the whole of it."""

    number: int  # by which the store knows it
    test: int  # number of the test
    model: str  # name of the model
    settings: str  # hash of the settings
    success: bool  # whether it converged
    message: str  # how it ended, or why there is none
    redchi: float  # as of :class:`rotorfit.FitResult`, NaN without a fit
    errors: tuple[str, ...]  # errors of the data, in words
    warnings: tuple[str, ...]  # of the check of the data and of the fit
    # values by name; the threshold speed is among them, by the name ``threshold_speed``
    params: Mapping[str, StoredValue]
    version: str  # of rotorfit that made it
    results: str  # version of its numbers

    @property
    def good(self) -> bool:
        """True if its values may be followed: it converged and the data have no error."""
        return self.success and not self.errors

    @property
    def outdated(self) -> bool:
        """True if this rotorfit may give other numbers; :meth:`Store.refit` makes such fits anew."""
        return self.results != RESULTS


@dataclass(frozen=True, kw_only=True)
class Added:
    """The outcome for one file, or for the recordings of one folder."""

    source: str  # the file or folder
    test: int | None = None  # number of the test, none where it was refused
    fit: int | None = None  # number of the fit, none without a study
    new_test: bool = False  # new_test, new_fit: whether the store did not have them before
    new_fit: bool = False
    refusal: str = field(default="")  # why the file was refused, empty where it was not


def insert(connection: sqlite3.Connection, table: str, row: Mapping[str, Any]) -> int:
    """Add a row to a table; returns its number."""
    marks = ", ".join(f":{column}" for column in row)
    return int(connection.execute(f"INSERT INTO {table} ({', '.join(row)}) VALUES ({marks})", row).lastrowid or 0)


def now() -> str:
    """The time, ISO 8601."""
    return datetime.now().isoformat(timespec="seconds")


def test_row(source: Source, machine: str, progress: StudyProgress) -> dict[str, Any]:
    """The row of a test that has been read."""
    experiments, findings = source.read(progress)
    said = said_by(experiments, str(source.path))
    return {
        "machine": machine,
        "date": source.date(),
        "date_given": False,
        **said,
        "findings": json.dumps([[[f.severity, f.code, f.message, f.source] for f in found] for found in findings]),
        "data": packed(json.dumps(encode(list(experiments)), allow_nan=False, ensure_ascii=False)),
        "added": now(),
        "version": __version__,
    }


def said_by(experiments: Sequence[Experiment], name: str) -> dict[str, Any]:
    """Columns of a test's row that its readings give."""
    attributes: dict[str, float | str] = {}
    for experiment in experiments:
        attributes |= conditions(experiment)
    own = str(attributes.get("machine", ""))
    dates = sorted(
        {str(d) for e in experiments if "date" in e.attributes for d in e.attributes["date"].tolist()} - {""}
    )
    if dates:
        as_time(dates[0], name)
    return {
        "content": content_hash(experiments),
        "kind": ", ".join(dict.fromkeys(test.title for test in experiments)),
        "readings": sum(map(len, experiments)),
        "conditions": json.dumps({n: v for n, v in attributes.items() if isinstance(v, str) or math.isfinite(v)}),
        **({"machine": own} if own else {}),
        **({"date": dates[0], "date_given": True} if dates else {}),
    }


def fit_row(outcome: Outcome | str) -> dict[str, Any]:
    """The row of a fit, or of the reason why there is none."""
    common = {"added": now(), "version": __version__, "results": RESULTS}
    if isinstance(outcome, str):
        none = json.dumps({"errors": [], "warnings": []})
        return {**common, "success": False, "message": outcome, "redchi": None, "findings": none, "result": None}
    best = outcome.best
    said = {"errors": outcome.data_errors, "warnings": outcome.warnings}
    return {
        **common,
        "success": best.success,
        "message": best.message,
        "redchi": best.redchi,
        "findings": json.dumps(said),
        "result": packed(fit_to_json(best)),
    }


def values_of(fit: FitResult) -> list[tuple[str, float | None, float | None, float | None, str]]:
    """Name, value, standard error, its share on trust and unit of what was fitted, and of the threshold speed."""
    rows = [(p.name, p.value, p.stderr, p.trust, p.unit, p.resolved) for p in fit.params.values() if p.vary]
    if fit.model.speed_dependent and fit.success and fit.problem.space.index.shape[0] == 1:
        onset = fit.threshold_speed()
        known = math.isfinite(onset.value) and math.isfinite(onset.stderr)
        trust = 0.0 if onset.error is None else onset.error.trust
        rows.append((THRESHOLD, onset.value, onset.stderr, trust, "rad/s", known))
    return [
        (name, *((value, error, share) if known and math.isfinite(error) else (None, None, None)), unit)
        for name, value, error, share, unit, known in rows
    ]


def _checked(record: Record) -> Record:
    """A record, refused where SQLite or JSON keeps something of another kind."""
    for f in fields(record):
        value = getattr(record, f.name)
        kind = {"str": str, "tuple[str, ...]": str, "int": int}.get(str(f.type), object)
        for one in value if isinstance(value, tuple) else (value,):
            if not isinstance(one, kind):
                raise TypeError(f"{one!r} stands where there should be {kind.__name__}")
    return record


def stored_findings(text: str) -> tuple[tuple[Finding, ...], ...]:
    """Findings of the check of the data, experiment by experiment."""
    return tuple(
        tuple(Finding(severity, code, message, source=source) for severity, code, message, source in found)
        for found in json.loads(text)
    )


def stored_test(row: Mapping[str, Any], paths: Sequence[str]) -> StoredTest:
    """The record of a row and of the files it was found in."""
    said = [finding for found in stored_findings(row["findings"]) for finding in found]
    read = {
        "date_given": bool(row["date_given"]),
        "conditions": dict(json.loads(row["conditions"])),
        "sources": tuple(paths),
        "findings": (*errors_in(said), *warnings_in(said)),
    }
    as_time(row["date"], f"test {row['number']}")
    return _checked(StoredTest(**shown_within({**row, **read})))


def stored_fit(row: Mapping[str, Any], params: Mapping[str, StoredValue]) -> StoredFit:
    """The record of a row and of its parameters."""
    own = {name: value for name, value in row.items() if name != "findings"}
    said = json.loads(row["findings"])
    read = {
        "success": bool(row["success"]),
        "redchi": math.nan if row["redchi"] is None else float(row["redchi"]),
        "errors": tuple(said["errors"]),
        "warnings": tuple(said["warnings"]),
        "params": params,
    }
    return _checked(StoredFit(**shown_within({**own, **read})))


def differing(test: StoredTest, said: Mapping[str, Any]) -> list[str]:
    """Columns of a test that are not as its readings say."""
    own = {"date_given": False, **said, "conditions": json.loads(said["conditions"])}
    return [name for name, value in own.items() if not _same(getattr(test, name), value)]


def odd_in_fit(fit: StoredFit, result: FitResult | None) -> list[str]:
    """What is not as the whole result says, or as it is where nothing could be fitted."""
    if result is None:
        return ["success"] * fit.success + list(fit.params)
    own = {"success": result.success, "message": result.message, "redchi": result.redchi, "model": result.model.name}
    odd = [name for name, value in own.items() if not _same(getattr(fit, name), value)]
    values = {
        name: [math.nan if number is None else number for number in numbers] + [unit]
        for name, *numbers, unit in values_of(result)
    }
    if fit.outdated:  # this version may find the threshold speed elsewhere
        values.pop(THRESHOLD, None)
    for name in dict.fromkeys((*values, *fit.params)):
        stored = fit.params.get(name)
        if name == THRESHOLD and fit.outdated:
            continue
        kept = [] if stored is None else [stored.value, stored.stderr, stored.systematic, stored.unit]
        if not _same(kept, values.get(name, [])):
            odd.append(name)
    return odd


def of_its_test(result: FitResult, test: StoredTest, settings: str) -> bool:
    """True if a result is of the readings of a test, where its settings leave them as they were read."""
    changed = any(f'"{key}"' in settings for key in ("undo", "baseline", "stator_mass_kg"))
    return changed or content_hash(result.experiments) == test.content


def rightly_superseded(test: StoredTest, tests: Mapping[int, StoredTest]) -> bool:
    """True if a test counts, or the tests in its place, one after the other, are of a file or folder that it came from
    and end in one that counts."""
    seen: set[int] = set()
    while test.superseded is not None:
        seen.add(test.number)
        later = tests.get(test.superseded)
        if later is None or later.number in seen or not set(test.sources) & set(later.sources):
            return False
        test = later
    return True


def _same(one: Any, other: Any) -> bool:
    """True if values are the same, numbers to what other processors round differently."""
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_same(one[name], other[name]) for name in one)
    if isinstance(one, list) and isinstance(other, list):
        return len(one) == len(other) and all(map(_same, one, other))
    if isinstance(one, float) and isinstance(other, int | float):
        return math.isclose(one, other, rel_tol=1e-6) or (math.isnan(one) and math.isnan(other))
    return bool(one == other)
