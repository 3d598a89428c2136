"""Reading files of unknown origin: one boundary for what packages raise over damaged ones, and checksums."""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

_WORDS = 160
"""Characters of a package's own message that are passed on."""
_LONG = re.compile(r"(\S{300})\S+")
"""A cell or name too long for a sentence."""


@contextmanager
def reading(name: str, kind: str) -> Iterator[None]:
    """Turn whatever is raised over a file into one :class:`ValueError` of one line that names it.

    Packages raise all kinds of exceptions on damaged files. Sentences that name the file pass, and so do a lack of
    memory and what the system says of a path.

    Args:
        name: of the file, as messages give it.
        kind: what the file should be, ``"WAV file"``.
    """
    try:
        yield
    except MemoryError:
        raise
    except Exception as problem:
        words = _LONG.sub(r"\1...", " ".join(str(problem).split()))
        of_a_path = isinstance(problem, OSError) and problem.filename is not None
        sentence = isinstance(problem, ValueError) and name in words
        if of_a_path or (sentence and words == str(problem)):
            raise
        if sentence:
            raise ValueError(words) from problem
        readable = isinstance(problem, (ValueError, OSError, RuntimeError)) and words.isprintable()
        why = f": {words[:_WORDS]}" if words and readable else ""
        raise ValueError(
            f"{name} is not a readable {kind} (cut short, damaged, or of another format){why}"
        ) from problem


def read_toml(path: Path, name: str) -> dict[str, Any]:
    """Content of a TOML file."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError as problem:
        raise ValueError(
            f"{name}: a TOML file is UTF-8 text, byte {problem.start} is not; save it as UTF-8"
        ) from problem


def checksum(parts: Iterable[Any]) -> str:
    """Fingerprint of numbers, arrays and text, to be stored beside them."""
    digest = hashlib.sha256()
    for part in parts:
        array = np.asarray(part)
        plain = array.astype(str) if array.dtype.kind in "OSU" else array
        content = "\0".join(plain.ravel().tolist()).encode() if plain.dtype.kind == "U" else plain.tobytes()
        digest.update(f"{plain.dtype.kind}{array.shape}{len(content)} ".encode() + content)
    return digest.hexdigest()


def check_sum(name: str, stored: Any, parts: Iterable[Any]) -> None:
    """Refuse content that is not what its checksum was made of; files of earlier versions have none."""
    if stored is not None and str(stored) != checksum(parts):
        raise ValueError(f"{name} is damaged, or was changed after it was written: its checksum does not agree")
