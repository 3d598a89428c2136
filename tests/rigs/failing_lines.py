"""Errors of the program that tests inject: lines that fail in a module of the package."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

LINES = {
    "a name that is none": "return undefined",
    "an entry that is none": "return {}['speed']",
    "an attribute that is none": "return None.speed",
    "a function called wrongly": "return len()",
    "a text that is no number": "return float('fast')",
    "arrays that do not fit": "return numpy.zeros(2) + numpy.zeros(3)",
}
"""Errors of a program by the line that fails."""


def of_rotorfit(line: str) -> Callable[..., Any]:
    """A function of one line that stands in a module of the package."""
    names: dict[str, Any] = {"__name__": "rotorfit.lab.io.written_by_the_test", "numpy": np}
    exec(f"def work(*given, **named): {line}", names)
    found: Callable[..., Any] = names["work"]
    return found
