"""The state of one tab: a study as its TOML file would say it, and what was computed from it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.app.folder import Folder
from rotorfit.models import MODELS
from rotorfit.recordings.formats.files import ALWAYS_RAW
from rotorfit.studies.data_files import no_progress, read_files
from rotorfit.studies.study import Study
from rotorfit.studies.study_file import study_of
from rotorfit.studies.study_model import build_model
from rotorfit.studies.wording import in_options, sentence, spoken

if TYPE_CHECKING:
    from rotorfit.data.experiments import Experiment
    from rotorfit.data.findings import Finding
    from rotorfit.models import RotorModel
    from rotorfit.studies.study import Outcome


@dataclass(frozen=True, kw_only=True, eq=False)
class Session:
    """One study, and what came of it."""

    folder: Folder  # what the server was started for
    content: Mapping[str, Any] = field(default_factory=dict)  # keys and values of the study's TOML file
    whole: tuple[Experiment, ...] = ()  # the data with all their readings
    experiments: tuple[Experiment, ...] = ()  # the data, without the readings that are left out
    findings: tuple[tuple[Finding, ...], ...] = ()  # what the data check found, file by file
    outcome: Outcome | None = None  # the result of this very study

    @property
    def study(self) -> Study:
        """The study as ``rotorfit run`` would read it."""
        return study_of(self.content, self.folder.root)

    @property
    def model(self) -> RotorModel:
        """The model with the options that data and study give it."""
        return build_model(self.study, self.experiments)

    def with_option(self, name: str, value: Any) -> Session:
        """The session with a key of the study set, or left out where the value is None or empty."""
        content = {key: item for key, item in self.content.items() if key != name}
        if value is not None and value != {}:
            content[name] = value
        return replace(self, content=content, outcome=None)

    def with_files(self, files: Sequence[Any]) -> Session:
        """The session with other data, read and looked over, whose model is one that has their planes."""
        model = self.content.get("model", next(iter(MODELS)))
        opened = self.with_option("files", list(files)).with_option("model", model)._read()
        opened = replace(opened, whole=opened.experiments)
        return opened if "model" in self.content else opened.with_option("model", _model_for(opened.whole))

    def skipped(self, test: int) -> frozenset[int]:
        """Rows of a test, with all its readings, that are left out."""
        entry, before = self._entry_of(test)
        skip = entry_table(self.content["files"][entry]).get("skip", ())
        return frozenset(number - 1 - before for number in skip) & frozenset(range(len(self.whole[test])))

    def with_skipped(self, test: int, rows: Iterable[int]) -> Session:
        """The session with these rows of a test, and no others of it, left out."""
        entry, before = self._entry_of(test)
        files = list(self.content["files"])
        table = entry_table(files[entry])
        own = range(before + 1, before + 1 + len(self.whole[test]))
        others = [number for number in table.pop("skip", ()) if number not in own]
        skip = sorted([*others, *(row + 1 + before for row in rows)])
        files[entry] = {**table, "skip": skip} if skip else table["path"] if set(table) == {"path"} else table
        return self.with_option("files", files)._read()

    def _read(self) -> Session:
        experiments, findings = read_files(self.study.files, no_progress)
        return replace(self, experiments=experiments, findings=findings)

    def _entry_of(self, test: int) -> tuple[int, int]:
        """Which entry of ``files`` a test came from, and how many readings of other tests came from it before."""
        raw = [i for i, entry in enumerate(self.content["files"]) if "recordings" in entry_table(entry)]
        if not raw:
            return test, 0
        if len(raw) > 1:
            raise ValueError("the study has several tables of recordings: edit their skip in the TOML file")
        last = raw[0] + len(self.whole) - len(self.content["files"])
        if not raw[0] <= test <= last:
            return (test if test < raw[0] else test - last + raw[0]), 0
        return raw[0], sum(len(one) for one in self.whole[raw[0] : test])


def entry_table(entry: Any) -> dict[str, Any]:
    """An entry of ``files`` as a table."""
    return {"path": entry} if isinstance(entry, str) else dict(entry)


def chosen(folder: Folder, names: Sequence[str], setup: str | None = None) -> list[Any]:
    """Entries of ``files`` for some files of the folder; with a setup all of them are recordings."""
    if not names:
        raise ValueError("choose at least one file")
    for name in (*names, *([setup] if setup else [])):
        folder.path(name)
    raw = [name for name in names if setup or Path(name).suffix.lower() in ALWAYS_RAW]
    entries: list[Any] = [name for name in names if name not in raw]
    return [*entries, {"recordings": raw, **({"setup": setup} if setup else {})}] if raw else entries


def toml_of(session: Session, *, absolute: bool) -> str:
    """The study as a TOML file: its paths relative to the folder, or absolute so that it runs from anywhere."""
    import tomli_w

    content = dict(session.content)
    if absolute:
        content["files"] = [_placed(entry, session.folder.root) for entry in content["files"]]
    return str(tomli_w.dumps(content))


def _placed(entry: Any, root: Path) -> dict[str, Any]:
    """An entry of ``files`` with absolute paths."""
    table = entry_table(entry)
    paths: dict[str, Any] = {key: str(root / table[key]) for key in ("path", "setup") if key in table}
    if "recordings" in table:
        paths["recordings"] = [str(root / name) for name in table["recordings"]]
    return {**table, **paths}


def _model_for(experiments: Sequence[Experiment]) -> str:
    """A model whose planes are those of the data, else the first."""
    planes = {plane for experiment in experiments for plane in experiment.planes}
    fitting = [name for name, model in MODELS.items() if set(model().planes) == planes]
    return (fitting or list(MODELS))[0]


def attempted(work: Callable[[], Session], otherwise: Session) -> tuple[Session, str]:
    """What work on a session gives, or the session as it was and the command line's sentence about what is wrong."""
    try:
        return work(), ""
    except (ValueError, KeyError, OSError) as problem:
        return otherwise, in_options(spoken(sentence(problem)))
