"""The state of one tab: a study as its TOML file would say it, and what was computed from it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from rotorfit.apps.app.folder import Folder
from rotorfit.apps.app.work import Data, Task
from rotorfit.apps.study_files.data_files import RecordingFiles, checked_again
from rotorfit.apps.study_files.run import with_errors_undone
from rotorfit.apps.study_files.study import build_model
from rotorfit.apps.study_files.study_file import study_of
from rotorfit.base.atomic_file import joined
from rotorfit.identify.diagnosis.data_errors import PHASE_ZEROS
from rotorfit.lab.data.selection import without
from rotorfit.lab.recordings.formats.files import ALWAYS_RAW
from rotorfit.models import MODELS

if TYPE_CHECKING:
    from rotorfit.apps.study_files.study import Study
    from rotorfit.lab.data.findings import Finding
    from rotorfit.lab.data.rows import Experiment
    from rotorfit.lab.recordings.recording import Recording
    from rotorfit.models import RotorModel


@dataclass(frozen=True, kw_only=True, eq=False)
class Session:
    """One study, and what came of it."""

    folder: Folder  # what the server was started for
    content: Mapping[str, Any] = field(default_factory=dict)  # keys and values of the study's TOML file
    records: tuple[Recording, ...] = ()  # the recordings among the files, opened
    data: Data | None = None  # the tests with all their readings, once they were read
    experiments: tuple[Experiment, ...] = ()  # the tests as the fit takes them
    findings: tuple[tuple[Finding, ...], ...] = ()  # what the data check found in them, test by test

    @property
    def study(self) -> Study:
        """The study as ``rotorfit run`` would read it."""
        return study_of({"model": next(iter(MODELS)), **self.content}, self.folder.root)

    @property
    def model(self) -> RotorModel:
        """The model with the options that data and study give it."""
        return build_model(self.study, self.experiments)

    def with_option(self, name: str, value: Any) -> Session:
        """The session with a key of the study set, or left out where the value says nothing."""
        content = {key: item for key, item in self.content.items() if key != name}
        if value not in (None, "", False, [], {}):
            content[name] = value
        return replace(self, content=content)

    def with_files(self, entries: Sequence[Any]) -> Session:
        """The session with other files, neither opened nor read yet."""
        return replace(self.with_option("files", list(entries)), records=(), data=None, experiments=(), findings=())

    @property
    def recorded(self) -> list[str]:
        """The recordings among the files."""
        return [name for entry in self.content["files"] for name in entry_table(entry).get("recordings", ())]

    def as_recordings(self) -> Session:
        """The session with its test files taken for recordings of raw signals."""
        tests = [entry_table(entry)["path"] for entry in self.content["files"] if "path" in entry_table(entry)]
        return self.with_files([{"recordings": [*tests, *self.recorded]}])

    def with_records(self) -> Session:
        """The session with its recordings opened, of which nothing but headings is read."""
        raw = [files for files in self.study.files if isinstance(files, RecordingFiles)]
        return replace(self, records=tuple(record for files in raw for record in files.open(lambda _: None)))

    def with_data(self, data: Data) -> Session:
        """The session with its files read, and a model that has their planes unless one is chosen."""
        read = replace(self, data=data)
        if "model" not in self.content:
            planes = {plane for experiment in data.experiments for plane in experiment.planes}
            fitting = [name for name, model in MODELS.items() if set(model().planes) == planes]
            read = read.with_option("model", (fitting or list(MODELS))[0])
        return read._prepared()

    def with_undone(self, finding: Finding) -> Session:
        """The session with the error of the data that a finding names undone."""
        if finding.code == PHASE_ZEROS:
            return self.with_option("phase_offsets", "common")
        return self.with_option("undo", [*self.content.get("undo", ()), finding.correction])._prepared()

    def with_all_errors(self) -> Session:
        """The session with the data as they were given."""
        return self.with_option("undo", None)._prepared()

    def with_model(self, name: str) -> Session:
        """The session with another model, and of the known values those that it has too."""
        own = MODELS[name]().parameter_names
        known = {key: value for key, value in self.content.get("known", {}).items() if key in own}
        return self.with_option("model", name).with_option("known", known)

    def skipped(self, test: int) -> frozenset[int]:
        """Rows of a test, with all its readings, that are left out."""
        entry, before = self._entry_of(test)
        skip = entry_table(self.content["files"][entry]).get("skip", ())
        return frozenset(number - 1 - before for number in skip) & frozenset(range(self._sizes[test]))

    def with_skipped(self, test: int, rows: Iterable[int]) -> Session:
        """The session with these rows of a test, and no others of it, left out."""
        entry, before = self._entry_of(test)
        files = list(self.content["files"])
        table = entry_table(files[entry])
        own = range(before + 1, before + 1 + self._sizes[test])
        others = [number for number in table.pop("skip", ()) if number not in own]
        files[entry] = {**table, "skip": sorted([*others, *(row + 1 + before for row in rows)])}
        return self.with_option("files", [_shortest(one) for one in files])._prepared()

    @property
    def _sizes(self) -> list[int]:
        return [] if self.data is None else [len(test) for test in self.data.experiments]

    def _prepared(self) -> Session:
        """The session with the tests as the fit takes them."""
        if self.data is None:
            return self
        whole = self.data.experiments
        kept = tuple(without(test, [row + 1 for row in self.skipped(i)]) for i, test in enumerate(whole))
        findings = checked_again(whole, kept, self.data.findings) if kept != whole else self.data.findings
        experiments, findings = with_errors_undone(self.content.get("undo", ()), kept, findings)
        return replace(self, experiments=experiments, findings=findings)

    def _entry_of(self, test: int) -> tuple[int, int]:
        """Which entry of ``files`` a test came from, and how many readings of other tests came from it before."""
        raw = [i for i, entry in enumerate(self.content["files"]) if "recordings" in entry_table(entry)]
        if not raw or test < raw[0]:  # recordings stand last
            return test, 0
        return raw[0], sum(self._sizes[raw[0] : test])


class Front(Protocol):
    """A page with its session, as the parts of the page use it."""

    session: Session

    def change(self, asked: Callable[[], Session]) -> None:
        """Give the session other data, or say why not."""

    def change_model(self, asked: Callable[[], Session]) -> None:
        """Give the session another model, or other options of the fit."""

    def opened_with(self, setup: str) -> None:
        """Open the same recordings with another setup, which has just been written."""

    def undo_in_data(self, finding: Finding) -> None:
        """Undo an error of the data."""

    def start(self, task: Task) -> None:
        """Begin long work on the study, in place of what is going on."""

    def say(self, words: str) -> None:
        """Say what is wrong with something that was entered."""


# ---- entries of files -----------------------------------------------------------------------------------------


def chosen_entries(folder: Folder, names: Sequence[str], setup: str | None = None) -> list[Any]:
    """Entries of ``files`` for some files of the folder; with a setup all of them are recordings."""
    if not names:
        raise ValueError("choose at least one file")
    for name in (*names, *([setup] if setup else [])):
        folder.path(name)
    raw = [name for name in names if setup or Path(name).suffix.lower() in ALWAYS_RAW]
    entries: list[Any] = [name for name in names if name not in raw]
    return [*entries, {"recordings": raw, **({"setup": setup} if setup else {})}] if raw else entries


def entry_table(entry: Any) -> dict[str, Any]:
    """An entry of ``files`` as a table."""
    return {"path": entry} if isinstance(entry, str) else dict(entry)


def _shortest(entry: Any) -> Any:
    """An entry without what says nothing."""
    table = {key: value for key, value in entry_table(entry).items() if value not in ("", [], {}, None)}
    return table["path"] if set(table) == {"path"} else table


def with_read_option(session: Session, entry: int, key: str, value: Any) -> Session:
    """The session with an option of reading one of its test files, or without where the value is None."""
    files = list(session.content["files"])
    files[entry] = _shortest({**entry_table(files[entry]), key: value})
    return session.with_files(files)


def toml_of(session: Session, *, absolute: bool) -> str:
    """The study as a TOML file: its paths relative to the folder, or absolute so that it runs from anywhere."""
    import tomli_w

    content = dict(session.content)
    if absolute:
        root, content["files"] = session.folder.root, [entry_table(entry) for entry in content["files"]]
        for table in content["files"]:
            table.update({key: str(joined(root, table[key])) for key in ("path", "setup") if key in table})
            if "recordings" in table:
                table["recordings"] = [str(joined(root, name)) for name in table["recordings"]]
        if "baseline" in content:
            content["baseline"] = str(joined(root, content["baseline"]))
    return str(tomli_w.dumps(content))
