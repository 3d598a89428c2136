"""Files that are written whole or not at all, never over one that the same command has read, nor outside a folder."""

from __future__ import annotations

import os
import re
import shutil
import threading
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

_inputs: ContextVar[set[tuple[int, int]] | None] = ContextVar("inputs", default=None)
"""Device and inode of the files read, while these are protected."""
_only: list[Path] = []
"""The folder that files are read from, where there is but one."""


@contextmanager
def reading_only_within(folder: Path) -> Iterator[None]:
    """Refuse to read files outside a folder, in this whole process, until the block ends: a server's."""
    _only.append(Path(os.path.realpath(folder)))
    try:
        yield
    finally:
        _only.pop()


def joined(folder: Path, name: str | Path, *, limit: Path | None = None) -> Path:
    """Path of a file that another file names, relative to a folder; refused where the path, or a link on it, leads out
    of the folder ``limit``. All names that come out of files are joined here."""
    path = folder / name
    try:
        real = Path(os.path.realpath(path))
    except ValueError as problem:  # a character that no path may have
        raise ValueError(f"{str(name)!a} is no name of a file") from problem
    if limit is not None and not real.is_relative_to(os.path.realpath(limit)):
        raise ValueError(f"{str(name)!r} is not within {limit}")
    return path


@contextmanager
def protected_inputs(paths: Iterable[Path]) -> Iterator[None]:
    """Refuse to write over these files, and over what :func:`note_input` names, until the block ends."""
    token = _inputs.set(set())
    try:
        for path in paths:
            _protect(path)
        yield
    finally:
        _inputs.reset(token)


def note_input(path: Path) -> None:
    """Protect a file that is being read; refuse a device, and a pipe, which would be waited for, and what is outside of
    the only folder that is read."""
    for only in _only:
        joined(only, path.absolute(), limit=only)
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise ValueError(f"{path} is a pipe or a device; give a file")
    _protect(path)


def _protect(path: Path) -> None:
    inputs = _inputs.get()
    if inputs is not None and path.exists():
        inputs.add(_identity(path))


def refuse_input(path: Path) -> None:
    """Raise an error if a file to write is one that was read, whatever it is called and whatever links lead to it."""
    inputs = _inputs.get()
    if inputs and path.exists() and _identity(path) in inputs:
        raise FileExistsError(f"{path} is one of the files read, and would be replaced; give the output another name")


def _identity(path: Path) -> tuple[int, int]:
    status = path.stat()
    return status.st_dev, status.st_ino


def file_name(text: str, taken: Collection[str] = ()) -> str:
    """A text that data gave, such as a run's name, as a part of a file's name that is not among those taken,
    which some systems compare without regard to capitals."""
    most = 100  # bytes, of 255 with what stands before and behind
    plain = re.sub(r"[^\w.+=,()\[\] -]", "-", text).lstrip(".").encode()[:most].decode(errors="ignore")
    used = {name.casefold() for name in taken}
    return next(
        name for name in (plain, *(f"{plain}-{i + 2}" for i in range(len(taken)))) if name.casefold() not in used
    )


def end_of_name(name: str) -> str:
    """As much of the end of a file's name as leaves room for the beginning of a draft's in what file systems allow."""
    most = 180  # bytes of 255
    return os.fsencode(name)[-most:].decode(errors="ignore")


def sweep(folder: Path, drafts: str) -> None:
    """Remove the drafts, of names that match an expression, that a kill left in a folder a day ago or earlier."""
    old_draft = 24 * 3600.0  # seconds after which a draft is no longer being written. Chosen.
    for name in [entry.name for entry in os.scandir(folder) if re.fullmatch(drafts, entry.name)]:
        draft = folder / name
        with suppress(OSError):  # of another user, or swept by another process meanwhile
            if time.time() - draft.lstat().st_mtime > old_draft:
                if draft.is_dir() and not draft.is_symlink():
                    shutil.rmtree(draft)
                else:
                    draft.unlink()


@contextmanager
def writing(path: Path, draft: Path) -> Iterator[None]:
    """Name the path in what the system says of its draft, or of no file, as of a full disk."""
    try:
        yield
    except OSError as problem:
        name = str(problem.filename or draft)
        if problem.errno is None or not name.startswith(str(draft)):
            raise
        raise OSError(problem.errno, problem.strerror, f"{path}{name.removeprefix(str(draft))}") from problem


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """A draft beside a file, of the same suffix, that takes its place when the block ends well. No reader ever sees
    half a file, and a failure or a kill leaves an old one as it was: the draft is on disk before it is renamed. A link
    keeps pointing where it does, and a file that is replaced keeps its mode."""
    refuse_input(path)
    target = Path(os.path.realpath(path))
    if not target.parent.is_dir():
        raise FileNotFoundError(f"cannot write {path}: there is no folder {path.parent}")
    name = end_of_name(target.name)
    sweep(target.parent, rf"\.\d+-\d+-{re.escape(name)}")
    draft = target.with_name(f".{os.getpid()}-{threading.get_ident()}-{name}")
    try:
        with writing(path, draft):
            yield draft
            with draft.open("rb+") as file:
                os.fsync(file.fileno())
            if target.exists():
                shutil.copymode(target, draft)
            os.replace(draft, target)
    finally:
        draft.unlink(missing_ok=True)
