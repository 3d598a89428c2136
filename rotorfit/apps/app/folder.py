"""The one folder that a server reads from and writes to, and what in it can be opened."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rotorfit.base.atomic_file import joined, whole_file
from rotorfit.lab.io.files import SUFFIXES
from rotorfit.lab.io.tables.cells import EXCEL
from rotorfit.lab.recordings.formats.files import FORMATS


@dataclass(frozen=True)
class Folder:
    """A folder; nothing outside of it is read or written."""

    root: Path  # absolute, without symbolic links

    def path(self, name: str) -> Path:
        """A file of the folder by its path in it."""
        return joined(self.root, name, limit=self.root)

    def write_new(self, name: str, text: str) -> Path:
        """Write a file of the folder, whole or not at all; one that is there is left alone."""
        path = self.path(name)
        if path.suffix != ".toml":
            raise ValueError(f"{name or 'the file'}: give a name that ends in .toml")
        if path.exists():
            raise FileExistsError(f"{name} is there already and is left alone; give another name")
        with whole_file(path) as draft:
            draft.write_text(text, encoding="utf-8")
        return path

    def free_name(self, name: str) -> str:
        """The name, with a number if it is taken: ``rig-2.toml``."""
        stem, suffix, number = Path(name).stem, Path(name).suffix, 1
        while self.path(name).exists():
            number += 1
            name = f"{stem}-{number}{suffix}"
        return name

    def data_files(self) -> list[str]:
        """Test files and recordings, as paths in the folder."""
        return self._named((*SUFFIXES, *EXCEL, *FORMATS))

    def setups(self) -> list[str]:
        """Files that may be setups of a rig."""
        return self._named((".toml",))

    def histories(self) -> list[str]:
        """Pages that a watch keeps beside a store."""
        return [name for name in self._named((".html",)) if (self.root / name).with_suffix(".db").is_file()]

    def _named(self, suffixes: Sequence[str]) -> list[str]:
        most_files = 500  # files that a list shows. Chosen: more are no list to choose from
        found: list[str] = []
        for place, folders, files in os.walk(self.root):
            folders[:] = sorted(name for name in folders if not name.startswith("."))
            for file in sorted(files):
                if not file.startswith(".") and Path(file).suffix.lower() in suffixes:
                    path = Path(place, file)
                    if Path(os.path.realpath(path)).is_relative_to(self.root):
                        found.append(path.relative_to(self.root).as_posix())
                if len(found) == most_files:
                    return sorted(found)
        return sorted(found)


def folder_of(files: Sequence[Path]) -> tuple[Folder, tuple[str, ...]]:
    """The folder that holds some files, and their paths in it; a folder among the files stands for itself."""
    for file in files:
        if not file.exists():
            raise FileNotFoundError(f"{file}: No such file or directory")
    real = [Path(os.path.realpath(file)) for file in files] or [Path.cwd().resolve()]
    above = [path if path.is_dir() else path.parent for path in real]
    root = Path(os.path.commonpath(above))
    return Folder(root), tuple(path.relative_to(root).as_posix() for path in real if not path.is_dir())
