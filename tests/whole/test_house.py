"""The measure of the house counts every way in which code can ask a kind, and chains of calls as they are."""

from __future__ import annotations

import ast

import house
import pytest

from rotorfit.base.digits import significant

ASKED = """
from rotorfit.models import Modal, RotorModel
from rotorfit.estimators.blocks.observations import Responses
"""


@pytest.mark.parametrize(
    ("code", "n"),
    [
        ("isinstance(model, Modal)", 1),
        ("isinstance(one, int | Responses) and issubclass(kind, (Modal, float))", 2),
        ("isinstance(model, RotorModel)", 1),  # the base of all kinds
        ("match model:\n  case Modal(modes=2) | None:\n    a\n  case _:\n    b", 1),
        ("table = {Modal: 1, Responses: 2}\ntable[type(block)]", 2),
        ("@title.register\ndef _(one: Modal): ...", 1),
        ("f'not a {type(model).__name__}'\ntype(model)()\nModal(modes=1)\nisinstance(1, int)\n{'Modal': 1}", 0),
    ],
)
def test_every_way_to_ask_a_kind_counts(monkeypatch: pytest.MonkeyPatch, code: str, n: int) -> None:
    whole = {**house.sources(), "asking": ast.parse(ASKED)}
    monkeypatch.setattr(house, "sources", lambda: whole)
    assert len(house.places("asking", ast.parse(code))) == n


def test_a_kind_may_ask_itself() -> None:
    asking = ast.parse("isinstance(self, Modal)")
    assert house.places("rotorfit.models.modal", asking) == []


def test_calls_are_those_of_rotorfit() -> None:
    calls = house.calls_of(lambda: [significant(value, 3) for value in (1.0, 2.0)])
    assert calls.files == ["rotorfit.base.digits"]
    assert ("rotorfit.base.digits", "significant") in calls.functions
    assert calls.depth == 2  # significant asks _exponent
