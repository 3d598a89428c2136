"""Cases of a parametrised test of which a few run by default and all before a release, pytest -m 'slow or not slow'."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest


def slow_but(cases: Iterable[Any], *quick: Any) -> list[Any]:
    """The cases, those that are not named marked slow."""
    listed = list(cases)
    unknown = [case for case in quick if case not in listed]
    if unknown:
        raise ValueError(f"no cases of this test: {unknown}")
    return [
        case if case in quick else pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow)
        for case in listed
    ]
