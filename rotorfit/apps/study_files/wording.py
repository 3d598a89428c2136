"""Results and exceptions as text."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

from rotorfit.base.faults import of_program


def sentence(problem: BaseException) -> str:
    """Message of an exception as a person would write it. An error of the program is none of theirs: raised again."""
    if of_program(problem):
        raise problem
    if isinstance(problem, KeyError) and problem.args:
        return str(problem.args[0])  # str() of a KeyError puts quotes around the sentence
    if isinstance(problem, OSError) and problem.strerror:
        return f"{problem.filename}: {problem.strerror}" if problem.filename else problem.strerror
    return str(problem)


def json_text(value: Any, indent: int | None = 1) -> str:
    """A result as JSON: records by their fields; numbers that are not finite, which it does not know, as null."""
    return json.dumps(_plain(value), indent=indent, allow_nan=False)


def _plain(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if is_dataclass(value):
        return {field.name: _plain(getattr(value, field.name)) for field in fields(value)}
    return value
