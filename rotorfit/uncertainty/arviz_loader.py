"""ArviZ without its banner: before version 1.0 it announces its successor at import, once a day, as a warning."""

from __future__ import annotations

import warnings
from typing import Any


def load_arviz() -> Any:
    """The module ``arviz``, imported now if it has not been.

    The announcement is for those who write against ArviZ, not for those who fit rotors; which day a machine last saw it
    must not decide what a user or a test sees.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"\s*ArviZ is undergoing", category=FutureWarning)
        import arviz
    return arviz
