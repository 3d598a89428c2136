"""Every golden case, codes and exit codes to the letter, values to a thousandth of their standard errors."""

from __future__ import annotations

import json
from collections.abc import Callable

import golden
import pytest

THEN = json.loads(golden.GOLDEN.read_text(encoding="utf-8"))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("name", "make"), [pytest.param(*case, id=case[0]) for case in golden.cases()])
def test_nothing_moves(name: str, make: Callable[[], golden.Numbers]) -> None:
    now = json.loads(json.dumps(golden.plain(make())))
    assert list(golden.differences(now, THEN[name], largest=1e-3)) == []
