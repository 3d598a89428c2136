"""Read a test, and warn of what is wrong with it where it is read."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec

from rotorfit.data.experiments import Experiment
from rotorfit.data.findings import DataWarning
from rotorfit.diagnosis.check import check
from rotorfit.io import files

P = ParamSpec("P")


def checking(reader: Callable[P, Experiment]) -> Callable[P, Experiment]:
    """A reader that warns of errors in what it reads."""

    @wraps(reader)
    def read(*args: P.args, **options: P.kwargs) -> Experiment:
        test = reader(*args, **options)
        for finding in check(test):
            if finding.severity == "error":
                warnings.warn(finding.message, DataWarning, stacklevel=2)
        return test

    return read


read = checking(files.read)
read.__module__ = __name__  # under which other processes find it
