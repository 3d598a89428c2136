"""Every golden case, codes and exit codes to the letter, values to a thousandth of their standard errors."""

from __future__ import annotations

import json
from collections.abc import Callable

import golden
import pytest

from rotorfit.base.version import RESULTS

THEN = json.loads(golden.GOLDEN.read_text(encoding="utf-8"))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("name", "make"), [pytest.param(*case, id=case[0]) for case in golden.cases()])
def test_nothing_moves(name: str, make: Callable[[], golden.Numbers]) -> None:
    now = json.loads(json.dumps(golden.plain(make())))
    assert list(golden.differences(now, THEN[name], largest=1e-3)) == []


def test_the_version_of_the_numbers_is_the_digest_of_the_file() -> None:
    assert golden.digest(THEN) == RESULTS


def test_a_case_is_written_anew_where_a_number_moved_and_its_sentences_always() -> None:
    """By more than the golden numbers allow; what stays within leaves the version of the numbers alone."""
    then = {"values": {"K": 100.0, "D": 5.0}, "stderr": {"K": 1.0, "D": 0.1}, "redchi": 1.0, "said": ["before"]}
    near = {**then, "values": {"K": 100.0 + 5e-7, "D": 5.0}, "redchi": 1.0 + 1e-12, "said": ["now"]}
    far = {**near, "values": {"K": 100.0 + 5e-6, "D": 5.0}}
    fewer = {**near, "values": {"K": 100.0}}
    assert golden.rewritten(near, then) == {**then, "said": ["now"]}
    assert golden.digest({"a": golden.rewritten(near, then)}) == golden.digest({"a": then})
    for other in (far, fewer):
        assert golden.rewritten(other, then) == other
        assert golden.digest({"a": other}) != golden.digest({"a": then})
    assert golden.rewritten(far, {}) == far
