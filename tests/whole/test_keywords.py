"""Keywords that are handed on are those of the function that takes them; another word is answered with all of them."""

from __future__ import annotations

from collections.abc import Callable
from inspect import Parameter, signature
from typing import Any

import pytest
from sentences import refuses

import rotorfit as rf
from rotorfit.identify.fitting.settings import FitKeywords, SampleKeywords
from rotorfit.lab.io.files import ReadKeywords


@pytest.mark.parametrize(
    ("function", "keywords", "own"),
    [(rf.fit, FitKeywords, {"known"}), (rf.sample, SampleKeywords, set()), (rf.read, ReadKeywords, {"kind"})],
)
def test_handed_on_is_what_the_function_takes(function: Callable[..., Any], keywords: type, own: set[str]) -> None:
    taken = {p.name: p.annotation for p in signature(function).parameters.values() if p.kind is Parameter.KEYWORD_ONLY}
    told = {name: kind.__forward_arg__ for name, kind in keywords.__annotations__.items()}
    assert told == {name: kind for name, kind in taken.items() if name not in own}


def test_a_wrong_word_is_answered_with_those_there_are() -> None:
    rig = rf.datasets.rig_open()
    fit = rf.closed_form(rf.models.WhirlWhip(), rig, known={"K3": 6000.0})
    with refuses(TypeError):
        fit.sample(walker=32)
    with refuses(TypeError):
        rf.compare_laws(rf.models.WhirlWhip(), rig, clearance_um=100, bound={})
    with refuses(TypeError):
        rf.sample_models([fit], step=32)
