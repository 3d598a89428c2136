"""Where tests come from, a file, or the recordings of a folder; what identifies settings and files."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from datetime import datetime
from errno import EINVAL
from functools import cached_property
from pathlib import Path
from stat import S_ISREG
from typing import Any

from rotorfit.apps.study_files.data_files import DataFile, RecordingFiles, StudyProgress, read_as, read_files
from rotorfit.apps.study_files.run import for_model
from rotorfit.apps.study_files.study import Study
from rotorfit.identify.fitting.json_values import encode
from rotorfit.identify.options.kinds import is_set
from rotorfit.identify.options.table import FIT, StudyOptions
from rotorfit.lab.data.findings import Finding
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.recordings.formats.files import ALWAYS_RAW
from rotorfit.lab.recordings.signals import SAMPLES_OF_A_PIECE


def settings_key(study: Study) -> tuple[str, str]:
    """Hash of the settings of a study, and the settings as JSON; files and folders do not count."""
    asked = {f.name: getattr(study, f.name) for f in fields(StudyOptions) if getattr(study, f.name) != f.default}
    given = {name: _sorted(encode(value)) for name, value in asked.items() if is_set(value, FIT[name].kind)}
    if study.structure:  # what the file holds counts, not where it is
        shaft = Path(study.structure)
        files = sorted(shaft.iterdir()) if shaft.is_dir() else [shaft]
        given["structure"] = key_of("".join(digest_of(file)[1] for file in files if file.is_file()))
    text = json.dumps({"model": study.model, **given}, sort_keys=True, allow_nan=False)
    return key_of(text), text


def _sorted(value: Any) -> Any:
    """JSON of which no order of keys counts."""
    if isinstance(value, Mapping):
        return {
            key: sorted(map(_sorted, item), key=json.dumps) if key == "mapping" else _sorted(item)
            for key, item in value.items()
        }
    return [_sorted(item) for item in value] if isinstance(value, list) else value


def key_of(text: str) -> str:
    """Hash of a text, of settings for instance."""
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def digest_of(path: Path, length: int | None = None) -> tuple[int, str]:
    """Size and SHA-256 of a file, or of so many bytes at its beginning."""
    digest, size = hashlib.sha256(), 0
    with path.open("rb") as stream:
        while piece := stream.read(SAMPLES_OF_A_PIECE if length is None else min(SAMPLES_OF_A_PIECE, length - size)):
            digest.update(piece)
            size += len(piece)
    return size, digest.hexdigest()


@dataclass(frozen=True, kw_only=True)
class Source:
    """A file of a test, or recordings that are one test together."""

    path: Path  # the file, or the folder of the recordings
    paths: tuple[Path, ...]  # the files
    setup: Path | None = None  # of the rig, for recordings
    study: Study | None = field(default=None, compare=False)  # how the files are read, and for which model

    @property
    def raw(self) -> bool:
        """True for recordings of raw signals."""
        return self.setup is not None or any(path.suffix.lower() in ALWAYS_RAW for path in self.paths)

    @property
    def name(self) -> str:
        """Path in the store, with escapes for bytes that are no text."""
        return os.fsencode(self.path.absolute()).decode("utf-8", "backslashreplace")

    def stamp(self) -> str:
        """Sizes and times of the files: equal where nothing has changed, without reading them.

        The time of the last change of the inode is one that no instrument and no copying program sets.
        """
        states = []
        for path in self.paths:
            status = path.stat()
            if not S_ISREG(status.st_mode):  # a pipe would be waited for, while other processes wait for this one
                raise OSError(EINVAL, "is no regular file", str(path))
            states.append((path.name, status.st_size, status.st_mtime_ns, status.st_ctime_ns))
        return json.dumps([*states, self._reading])

    @cached_property
    def _reading(self) -> str:
        """How the files are read, as a hash."""
        text = repr(sorted(self._file.options.items())) if isinstance(self._file, DataFile) else ""
        rig = self.setup.read_bytes() if self.setup is not None else b""
        return hashlib.sha256(text.encode("utf-8") + rig).hexdigest()

    def identity(self) -> str:
        """Parts of the test: files by their content, and how they are read."""
        return json.dumps([[[path.name, *digest_of(path)] for path in self.paths], self._reading])

    def may_be(self, identity: str) -> bool:
        """False if the files are others than those of an identity by name or size, which asks for no reading."""
        sizes = [(path.name, path.stat().st_size) for path in self.paths]
        return [(name, size) for name, size, _ in _parts(identity)] == sizes

    def date(self) -> str:
        """Time of the latest file, by the file system."""
        latest = max(path.stat().st_mtime for path in self.paths)
        return datetime.fromtimestamp(latest).isoformat(timespec="seconds")

    def read(self, progress: StudyProgress) -> tuple[tuple[Experiment, ...], tuple[tuple[Finding, ...], ...]]:
        """The tests, and what was found odd in each."""
        file = self._file if self.study is None else for_model(self.study, self._file)
        return read_files([file], progress)

    @cached_property
    def _file(self) -> DataFile | RecordingFiles:
        if self.raw:
            return RecordingFiles(paths=self.paths, setup=self.setup)
        return read_as(self.path, () if self.study is None else self.study.files)


def continues(source: Source, identity: str) -> bool:
    """True if the files are those of an earlier state of the source, by name, size and hash, some of them longer, or
    with further ones."""
    now, earlier = {path.name: path for path in source.paths}, _parts(identity)
    return bool(earlier) and all(
        name in now and digest_of(now[name], size) == (size, digest) for name, size, digest in earlier
    )


def _parts(identity: str) -> list[tuple[str, int, str]]:
    """Name, size and hash of each file of an identity; none where a damaged store has something else."""
    try:
        return [(str(name), int(size), digest) for name, size, digest in json.loads(identity)[0]]
    except (ValueError, TypeError, LookupError, OverflowError, RecursionError):
        return []


def sources_of(
    files: Sequence[Path], study: Study | None, setup: Path | None, progress: Callable[[str], None]
) -> list[Source]:
    """The sources among files and folders: each file by itself, but the recordings of a folder together."""
    found = []
    for path in files:
        source = Source(path=path, paths=(path,), setup=setup, study=study)
        if path.is_dir():
            inside = tuple(sorted(file for file in path.iterdir() if file.is_file() and not file.name.startswith(".")))
            source = replace(source, paths=inside)
            if not inside:
                raise ValueError(f"{path} is an empty folder; a folder stands for the recordings of one test")
        found.append(source)
        progress(f"looking at {path.name}")
    return found
