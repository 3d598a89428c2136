"""Random numbers that a seed makes again: functions that draw some take ``rng`` and, meaning the same, ``seed``."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

Seed: TypeAlias = int | np.random.Generator | None
"""A generator or its seed; None for what a function does by default."""


def chance(rng: Seed, seed: Seed, default: int) -> int | np.random.Generator:
    """What was given by either name."""
    if rng is not None and seed is not None:
        raise TypeError("rng and seed are given; they mean the same, one is enough")
    given = seed if rng is None else rng
    return default if given is None else given


def seed_of(rng: Seed, seed: Seed, default: int) -> int:
    """The same as a number that is kept with a result; a generator draws it."""
    given = chance(rng, seed, default)
    return int(given.integers(2**32)) if isinstance(given, np.random.Generator) else given
