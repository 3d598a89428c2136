"""A folder for results: complete or not there, with the checkpoint of a sampling that was stopped."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

CHECKPOINT = "posterior.checkpoint.h5"
"""File in the folder for the results from which a sampling that was stopped goes on."""


@contextmanager
def complete_folder(out: Path) -> Iterator[Path]:
    """A temporary folder whose files move into ``out`` when the block ends well; otherwise nothing is left behind."""
    for above in (out, *out.parents):
        if above.exists() and not above.is_dir():
            raise NotADirectoryError(f"{above} is a file; give a folder for the results")
    place = next(folder for folder in (out.absolute(), *out.absolute().parents) if folder.is_dir())
    try:  # on the file system of the folder itself, so that moving is renaming
        temporary = tempfile.TemporaryDirectory(prefix=".rotorfit-", dir=place)
    except OSError as reason:
        raise PermissionError(f"cannot write to {place}: {reason.strerror}; give another folder") from reason
    with temporary as name:
        yield Path(name)
        out.mkdir(parents=True, exist_ok=True)
        for file in sorted(Path(name).iterdir()):
            os.replace(file, out / file.name)


@contextmanager
def kept_checkpoint(out: Path) -> Iterator[Path]:
    """The sampler's checkpoint in ``out``: kept when the run is stopped, gone when it is complete."""
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
