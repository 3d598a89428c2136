"""Names that are not known, with the nearest one that is."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def unknown_name(kind: str, name: str, allowed: Iterable[str]) -> str:
    """Sentence for an error: the unknown name, the nearest known one, and all that is allowed."""
    longest = 80  # characters of an unknown name that are compared and shown
    allowed, name = list(allowed), name[:longest]
    near = difflib.get_close_matches(name, allowed, n=1, cutoff=0.5)
    if not near:
        near = [other for other in allowed if other.lower() == name.lower()]
    hint = f", did you mean {near[0]!r}?" if near else "."
    return f"unknown {kind} {name!r}{hint} Allowed: {', '.join(allowed)}"
