"""How a command ends: exit codes, and what the user got wrong as one sentence."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from pathlib import Path
from typing import TypeVar

from rotorfit.studies.wording import sentence


class ExitCode(IntEnum):
    """Exit codes of the commands."""

    DONE = 0
    NOT_CONVERGED = 1
    BAD_INPUT = 2
    ALARM = 3
    INTERRUPTED = 130


T = TypeVar("T")


class BadInputError(Exception):
    """Something in the user's hands is wrong; the message says what, where and what to do."""


def checked(work: Callable[[], T], of: Path | None = None) -> T:
    """Do work that depends on the user's files and settings; what they get wrong becomes a :class:`BadInputError`, with
    the file that the settings are of."""
    try:
        return work()
    except BrokenPipeError:  # of the output, whose reader has seen enough
        raise
    except (ValueError, KeyError, OSError) as problem:
        words = sentence(problem)
        raise BadInputError(words if of is None or str(of) in words else f"{of}: {words}") from problem
