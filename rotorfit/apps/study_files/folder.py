"""A folder for results: one whole result or the one before, with the checkpoint of a sampling that was stopped."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from rotorfit.base.atomic_file import end_of_name, refuse_input, sweep, writing

CHECKPOINT = "posterior.checkpoint.h5"
"""File in the folder for the results from which a sampling that was stopped goes on."""

CONTENTS = ".rotorfit-result"
"""File in the folder that names the files of the result, so that others in it are left alone."""


@contextmanager
def complete_folder(out: Path) -> Iterator[Path]:
    """A draft folder whose files are the result in ``out`` when the block ends well; else nothing is left behind. A
    result that is there becomes ``out.previous``, in place of one of that name; files that are no result stay. The
    folder is switched by renaming: whoever looks, or is left with it after a kill, has one result or the other."""
    for above in (out, *out.parents):
        if above.exists() and not above.is_dir():
            raise NotADirectoryError(f"{above} is a file; give a folder for the results")
    target = Path(os.path.realpath(out))
    earlier = _result_in(target)
    previous = target.with_name(f"{target.name}.previous")
    if earlier:
        _check_switch(out, target, previous)
    place = target.parent if earlier else next(folder for folder in (target, *target.parents) if folder.is_dir())
    name = end_of_name(target.name)
    sweep(place, rf"\.rotorfit-\d+-{re.escape(name)}")
    draft = place / f".rotorfit-{os.getpid()}-{name}"
    try:  # on the file system of the folder itself, so that moving is renaming
        draft.mkdir()
    except OSError as reason:
        raise PermissionError(f"cannot write to {place}: {reason.strerror}; give another folder") from reason
    try:
        with writing(out, draft):
            yield draft
        names = sorted(file.name for file in draft.iterdir())
        (draft / CONTENTS).write_text("\n".join(names) + "\n", encoding="utf-8", errors="surrogateescape")
        earlier = _result_in(target)  # another run may have ended meanwhile
        _check_replaced(out, earlier, names, previous)
        if earlier:
            _switch(draft, target, previous, earlier)
        elif target.exists():
            for name in (CONTENTS, *names):  # the list first, so that after a kill the next run knows what is its own
                os.replace(draft / name, target / name)
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            os.rename(draft, target)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _result_in(folder: Path) -> frozenset[str]:
    """Names of the files of the result that a folder holds."""
    contents = folder / CONTENTS
    if not contents.is_file():
        return frozenset()
    names = contents.read_text(encoding="utf-8", errors="surrogateescape").split("\n")[:-1]
    return frozenset(name for name in names if name == Path(name).name)  # no path that leads elsewhere


def _check_switch(out: Path, target: Path, previous: Path) -> None:
    """Refuse a result that could not be kept as the previous one, before any work."""
    if target in (here := Path.cwd().resolve(), *here.parents) or os.path.ismount(target):
        raise FileExistsError(
            f"{out} holds an earlier result and is in use, so that it cannot be renamed; give another folder"
        )
    if os.path.lexists(previous) and not _result_in(previous):
        raise FileExistsError(f"{previous}, to which the result in {out} goes, holds something else; move it away")


def _check_replaced(out: Path, earlier: frozenset[str], names: Sequence[str], previous: Path) -> None:
    """Refuse to replace what was read, and what is no result."""
    for name in {*earlier, *names}:
        refuse_input(out / name)
    for name in _result_in(previous) if earlier else ():
        refuse_input(previous / name)
    for name in names:
        if name not in earlier and (out / name).exists():
            raise FileExistsError(
                f"{out / name} exists and is no result of rotorfit, as far as {CONTENTS} says; give another folder"
            )


def _switch(draft: Path, target: Path, previous: Path, earlier: frozenset[str]) -> None:
    """Put the result that is there aside and the new one in its place, and take along what is no result."""
    shutil.copymode(target, draft)
    for file in draft.iterdir():
        if file.name in earlier and (target / file.name).exists():
            shutil.copymode(target / file.name, file)
    if previous.exists():
        _move_others(previous, _result_in(previous), target)  # that a kill has left there
        shutil.rmtree(previous)
    try:
        os.rename(target, previous)
        os.rename(draft, target)
    except BaseException:
        if not target.exists():
            os.rename(previous, target)
        raise
    _move_others(previous, earlier, target)


def _move_others(folder: Path, result: frozenset[str], target: Path) -> None:
    """Move what is in a folder beside its result."""
    for other in [path for path in folder.iterdir() if path.name not in result and path.name != CONTENTS]:
        if (target / other.name).exists():
            raise FileExistsError(f"{other} is no result and would be lost; move it away")
        os.rename(other, target / other.name)


@contextmanager
def kept_checkpoint(out: Path) -> Iterator[Path]:
    """The sampler's checkpoint in ``out``: kept when the run is stopped, gone when its result is written."""
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    out.mkdir(parents=True, exist_ok=True)
    path = out / CHECKPOINT
    try:
        yield path
        path.unlink(missing_ok=True)
    except KeyboardInterrupt as stop:
        if not path.exists():
            raise
        raise KeyboardInterrupt(f"the same command goes on from {path}") from stop
    finally:
        for folder in made:
            if not any(folder.iterdir()):
                folder.rmdir()
