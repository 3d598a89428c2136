"""Names that are not known, with the nearest one that is."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable

_LONGEST = 80
"""Characters of an unknown name that are compared and shown."""


def unknown_name(kind: str, name: str, allowed: Iterable[str]) -> str:
    """Sentence for an error: the unknown name, the nearest known one, and all that is allowed. Units and suffixes have
    no near ones: one letter makes another unit, or another format."""
    allowed, name = list(allowed), name[:_LONGEST]
    alike = any(word in ("unit", "suffix") for word in kind.split())
    near = "" if alike else nearest(name, allowed, 0.5)
    near = near or next((other for other in allowed if other.lower() == name.lower()), "")
    hint = f", did you mean {near!r}?" if near else "."
    return f"unknown {kind} {name!r}{hint} Allowed: {', '.join(allowed)}"


def nearest(name: str, allowed: Iterable[str], cutoff: float) -> str:
    """The nearest of some names that is of the same quantity and unit; empty where none is."""
    near = difflib.get_close_matches(name[:_LONGEST], list(allowed), n=5, cutoff=cutoff)
    near.sort(key=lambda other: sorted(other) != sorted(name))  # letters exchanged, before others left out
    return next((other for other in near if _same_quantity(name, other) and _same_unit(name, other)), "")


def _same_quantity(name: str, other: str) -> bool:
    """True unless the first of several words is another one: what is measured stands there."""
    (word, *rest), (known, *others) = (re.split(r"[_ ]+", each.lower()) for each in (name, other))
    alike = 0.6  # of a word that is misspelt; mobility and velocity are a half
    short = word.startswith(known) or known.startswith(word)
    return not (rest and others) or short or difflib.SequenceMatcher(None, word, known).ratio() >= alike


def _same_unit(name: str, other: str) -> bool:
    """True unless the ends of two names of several words may be different units: short words that are not the same."""
    plain = [re.sub(r"[\W_]", "", each).lower() for each in (name, other)]
    if plain[0] == plain[1] or other.lower().startswith((f"{name.lower()} [", f"{name.lower()} (")):
        return True
    words, others = (re.findall(r"[^\W_]+", each.lower()) for each in (name, other))
    if len(words) == len(others) == 1:
        return True
    word = 4  # letters from which the end of a name is a word and no unit
    last, end = words[-1], others[-1]
    if len(last) >= word and (others[: len(words)] == words or len(end) >= word):
        return True  # the unit is missing, or a word is misspelt
    if len(end) >= word and words[:-1] == others[:-1]:
        return True  # a letter of the word is missing
    if len(words) != len(others):
        return False
    short = [pair for pair in zip(words, others, strict=True) if max(map(len, pair)) < word]
    return all(sorted(one) == sorted(known) for one, known in [*short, (last, end)])  # of uin_pp, too
