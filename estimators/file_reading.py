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
_PYTHON = re.compile(r"<(?:class ')?([\w.]+)(?:'| object at 0x[0-9a-f]+)>")
"""A type, or an object without a name of its own, as Python writes it."""

_STEERING = re.compile("[\x00-\x1f\x7f-\x9f\u2028-\u202e\u2066-\u2069\ud800-\udfff]")
"""Characters that steer a terminal, begin a line or turn the direction of writing, and halves of characters."""

_SEAL = b"rotorfit sha256 "
"""First bytes of a checksum at the end of a file."""


def shown(name: str) -> str:
    """A name that a file gives, as it is shown and written: on one line, and unable to steer what shows it."""
    return _STEERING.sub(lambda found: found[0].encode("unicode_escape").decode(), name)


def shown_lines(text: str) -> str:
    """The same of text that has lines and columns of its own."""
    return "\n".join("\t".join(map(shown, line.split("\t"))) for line in text.split("\n"))


@contextmanager
def reading(name: str, kind: str) -> Iterator[None]:
    """Turn whatever is raised over a file, ``kind`` being what it should be, into one :class:`ValueError` of one line
    that names it. Sentences that name the file pass, and so does what the system says of a path. A name that is no text
    of one line is refused: it goes into figures, tables and stores."""
    if shown(name) != name:
        raise ValueError(
            f"{name!a}: names of files and folders must be text in UTF-8 without control characters; rename it"
        )
    try:
        yield
    except MemoryError as problem:
        raise ValueError(
            f"{name} takes more memory than there is, as a damaged {kind} may that declares what it does not hold"
        ) from problem
    except RecursionError as problem:
        raise ValueError(f"{name} is not a readable {kind}: its content is nested too deeply") from problem
    except Exception as problem:
        words = _PYTHON.sub(r"\1", _LONG.sub(r"\1...", " ".join(str(problem).split())))
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
    note_input(path)
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as problem:
        raise ValueError(
            f"{name}: a TOML file is UTF-8 text, byte {problem.start} is not; save it as UTF-8"
        ) from problem
    check_dots(name, text)
    content: dict[str, Any] = _shown_within(tomllib.loads(text))
    return content


def _shown_within(value: Any) -> Any:
    """Values of a TOML file with all texts in them as they are shown."""
    if isinstance(value, dict):
        return {shown(key): _shown_within(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_shown_within(item) for item in value]
    return shown(value) if isinstance(value, str) else value


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
