"""Sentences of the program in the words of the page: without names of arguments, options and commands."""

from __future__ import annotations

import re

from rotorfit.identify.options.table import FIT

_NAMED = r"(?:--[a-z]|\brf\.|\bfit\.[a-z]|\b[a-z_]+=|`rotorfit )"
_INNER = r"(?:[^()]|\([^()]*\))*"
_ASIDE = re.compile(rf"\s*\({_INNER}{_NAMED}{_INNER}\)")
"""Parentheses that say how Python or the command line is told something."""
_IN_PLACE = (
    (
        re.compile(
            r"write a setup: `rotorfit template [^`]*` makes one of the file's own channels to fill in; then give it"
        ),
        "say below which channel is what",
    ),
    (
        re.compile(r"A column of another name is said with it \([^()]*\)"),
        "Say below which columns have other names",
    ),
    (
        re.compile(r"read it with a setup of the rig; `rotorfit template [^`]*` makes one to fill in"),
        "say below that it holds raw signals",
    ),
)
_OPTION = re.compile(r"`?(--[a-z][a-z-]*)(?:[ =][\w*]+=[\w.:*]+)?`?")
_KEYS = {one.word: name for name, one in FIT.items()}


def on_the_page(text: str) -> str:
    """A sentence as the page says it; an option that it has no words for is the key of a study's file."""
    for words, instead in _IN_PLACE:
        text = words.sub(instead, text)
    text = _ASIDE.sub("", text)
    return _OPTION.sub(
        lambda found: f"{_KEYS.get(found[1], found[1].strip('-').replace('-', '_'))} in study.toml", text
    )
