"""Reading files of unknown origin: one boundary for what packages raise over damaged ones, and seals."""

from __future__ import annotations

import hashlib
import re
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rotorfit.estimators.atomic_file import note_input
from rotorfit.estimators.file_limits import check_dots

_WORDS = 160
"""Characters of a package's own message that are passed on."""
_LONG = re.compile(r"(\S{300})\S+")
"""A cell or name too long for a sentence."""

_SEAL = b"rotorfit sha256 "
"""First bytes of a checksum at the end of a file."""


@contextmanager
def reading(name: str, kind: str) -> Iterator[None]:
    """Turn whatever is raised over a file, ``kind`` being what it should be, into one :class:`ValueError` of one line
    that names it. Sentences that name the file pass, and so does what the system says of a path. A name that is no text
    is refused: it goes into figures, tables and stores."""
    if not _is_text(name):
        raise ValueError(f"{name!a}: names of files and folders must be text in UTF-8; rename it")
    try:
        yield
    except MemoryError as problem:
        raise ValueError(
            f"{name} takes more memory than there is, as a damaged {kind} may that declares what it does not hold"
        ) from problem
    except RecursionError as problem:
        raise ValueError(f"{name} is not a readable {kind}: its content is nested too deeply") from problem
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


def _is_text(name: str) -> bool:
    try:
        name.encode("utf-8")
    except UnicodeEncodeError:
        return False
    return True


def read_toml(path: Path, name: str) -> dict[str, Any]:
    """Content of a TOML file."""
    note_input(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as problem:
        raise ValueError(
            f"{name}: a TOML file is UTF-8 text, byte {problem.start} is not; save it as UTF-8"
        ) from problem
    check_dots(name, text)
    return tomllib.loads(text)


def seal(path: Path) -> None:
    """Put a checksum of all bytes behind a file whose format ends before; an HDF5 file loses it where it is changed."""
    with path.open("rb+") as file:
        digest = hashlib.file_digest(file, "sha256").digest()
        file.write(_SEAL + digest)


def is_sealed(path: Path) -> bool | None:
    """True if a file is as it was sealed; None if it has no seal, as those of earlier versions and of others."""
    content = path.read_bytes()
    body, mark, digest = content[:-48], content[-48:-32], content[-32:]
    return hashlib.sha256(body).digest() == digest if mark == _SEAL else None


def check_seal(path: Path, name: str) -> None:
    """Refuse a file that is not as it was sealed."""
    if is_sealed(path) is False:
        raise ValueError(f"{name} is damaged: its bytes are not those that were written (the checksum does not agree)")
