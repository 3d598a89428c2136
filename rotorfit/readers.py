"""Read and write experiments; the suffix of the file tells the format."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rotorfit.experiments import Experiment, PerturbationTest
from rotorfit.synchronous import SPEED_TOLERANCE, difference_synchronous


def read(
    path: str | Path, *, difference: bool = True, speed_tolerance: float = SPEED_TOLERANCE
) -> Experiment:
    """Read a test."""
    from rotorfit.csv_io import read_csv

    test = read_csv(path, speed_tolerance=speed_tolerance)
    if difference and isinstance(test, PerturbationTest) and test.synchronous:
        test = difference_synchronous(test)
    return test
