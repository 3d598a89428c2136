"""Kinds of values that an option can have: read from TOML, read from the command line, written back to it."""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from rotorfit.estimators.misfit.parameter_space import LARGEST

Planes: TypeAlias = tuple[str, ...] | Mapping[str, int | str]
"""Names of planes; on a shaft from a file with the node of each, or the tag of an element that stands there."""

Parser = Callable[[str, Any], Any]
"""From a key and the value that stands there in a TOML file to the setting; refuses with a ValueError."""


# ---- values in TOML ---------------------------------------------------------------------------


def text(key: str, value: Any) -> str:
    """A text that is not empty."""
    if not isinstance(value, str) or not value:
        raise ValueError(f"{key} must be a text, got {value!r}")
    return value


def flag(key: str, value: Any) -> bool:
    """True or false."""
    if not isinstance(value, bool):
        raise ValueError(f"{key} must be true or false, got {value!r}")
    return value


def number(key: str, value: Any) -> float:
    """A number."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError(f"{key} must be a number, got {value!r}")
    if not abs(value) <= LARGEST:
        raise ValueError(f"{key} must be a finite number, at most {LARGEST:g} either way; got {value!r}")
    return float(value)


def _positive(key: str, value: Any) -> float:
    """A number above zero."""
    if not number(key, value) > 0:
        raise ValueError(f"{key} must be above zero, got {value!r}")
    return float(value)


def phase_offsets(key: str, value: Any) -> Any:
    """True, false or "common"."""
    if value != "common" and not isinstance(value, bool):
        raise ValueError(f'{key} must be true, false or "common", got {value!r}')
    return value


def whole(key: str, value: Any) -> int:
    """A whole number from zero."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise ValueError(f"{key} must be a whole number, not below zero; got {value!r}")
    return value


def count(key: str, value: Any) -> int:
    """A whole number from one."""
    if whole(key, value) == 0:
        raise ValueError(f"{key} must be at least 1, got {value!r}")
    return int(value)


def pair(key: str, value: Any) -> tuple[float, float]:
    """Two numbers."""
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f"{key} must be two numbers in brackets, got {value!r}")
    open_ends = (math.inf, -math.inf)
    low, high = (float(end) if end in open_ends else number(key, end) for end in value)
    return low, high


def one_or_more(of: Parser) -> Parser:
    """Reader of one value, or of a list of them."""
    return lambda key, value: tuple(of(key, one) for one in (value if isinstance(value, list) else [value]))


def numbers(key: str, value: Any) -> Any:
    """Numbers, one, or evenly spaced ones, ``{from = 100, to = 3000, count = 40}``."""
    if not isinstance(value, dict):
        return list(one_or_more(number)(key, value))
    if set(value) != {"from", "to", "count"}:
        raise ValueError(f"{key} as a table is {{from = 100, to = 3000, count = 40}}, got {value!r}")
    low, high = (number(f"{key}.{end}", value[end]) for end in ("from", "to"))
    if count(f"{key}.count", value["count"]) > _MOST:
        raise ValueError(f"{key}.count must be at most {_MOST}, got {value['count']}")
    return np.linspace(low, high, value["count"])


_MOST = 1_000_000
"""Evenly spaced numbers that a table stands for at most."""


def _texts(key: str, value: Any) -> tuple[str, ...]:
    """A list of texts."""
    if not isinstance(value, list):
        raise ValueError(f"{key} must be a list of texts, got {value!r}")
    return tuple(text(key, item) for item in value)


def _planes(key: str, value: Any) -> Planes:
    """A list of names, or a table of nodes by name."""
    if not isinstance(value, dict):
        return _texts(key, value)
    return {name: at if isinstance(at, str) else whole(f"{key}.{name}", at) for name, at in value.items()}


def table(of: Parser) -> Parser:
    """Reader of a table whose values are of one kind."""

    def parse(key: str, value: Any) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise ValueError(f"{key} must be a table, got {value!r}")
        return {name: of(f"{key}.{name}", item) for name, item in value.items()}

    return parse


def _known(key: str, value: Any) -> float | tuple[float, float] | None:
    """A number, a number with its error, or "free" for a parameter that is to be fitted."""
    if value == "free":
        return None
    if isinstance(value, str):
        raise ValueError(f'{key} must be a number, or "free" to fit it, got {value!r}')
    if isinstance(value, list):
        if len(value) != 2:
            raise ValueError(f"{key} must be a number, or one with its error as [6000, 30], got {value!r}")
        return number(key, value[0]), number(key, value[1])
    return number(key, value)


def _known_word(word: str) -> float | tuple[float, float] | None:
    """The same as a word: ``6000``, ``6000+-30``, ``free``."""
    if word.lower() in ("free", "none"):
        return None
    value, sign, error = word.partition("+-")
    return (number_word(value), number_word(error)) if sign else number_word(value)


def _known_written(value: float | tuple[float, float] | None) -> str:
    numbers = value if isinstance(value, tuple) else (value,)
    return "+-".join("free" if number is None else f"{number:.10g}" for number in numbers)


def uncertainty(key: str, value: Any) -> Any:
    """A number for all probes or planes, or one by plane."""
    if isinstance(value, dict):
        return {place: number(f"{key}.{place}", item) for place, item in value.items()}
    return number(key, value)


def prior(key: str, value: Any) -> Any:
    """A distribution of scipy.stats with its numbers."""
    if not isinstance(value, dict) or len(value) != 1:
        raise ValueError(f"{key} must be one distribution with its numbers, {{norm = [1.0, 0.01]}}; got {value!r}")
    ((name, numbers),) = value.items()
    if not isinstance(numbers, list):
        raise ValueError(f"{key}: {name} needs a list of numbers, got {numbers!r}")
    return _frozen_prior(key, name, [number(key, item) for item in numbers])


def _frozen_prior(where: str, name: str, numbers: Sequence[float]) -> Any:
    """A ``scipy.stats`` distribution by name, frozen with its shape numbers, location and scale."""
    from scipy import stats

    from rotorfit.base.names import unknown_name

    distribution = getattr(stats, name, None)
    if not isinstance(distribution, stats.rv_continuous):
        allowed = [n for n in stats.__all__ if isinstance(getattr(stats, n), stats.rv_continuous)]
        sentence = unknown_name("distribution", name, allowed).partition(" Allowed:")[0]
        raise ValueError(f"{where}: {sentence} Any continuous distribution of scipy.stats is allowed")
    try:
        frozen = distribution(*numbers)
    except TypeError as reason:
        raise ValueError(f"{where}: {name} does not take the numbers {list(numbers)}") from reason
    if not frozen.std() > 0:
        raise ValueError(f"{where}: {name} has no positive spread with the numbers {list(numbers)}")
    return frozen


# ---- words of the command line ----------------------------------------------------------------


def positive_word(word: str) -> float:
    """A number above zero."""
    try:
        value = float(word)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{word!r} is not a number") from None
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{word} is not above zero")
    return value


def probability_word(word: str) -> float:
    """A number between zero and one."""
    if positive_word(word) >= 1:
        raise argparse.ArgumentTypeError(f"{word} is no probability, which is below 1")
    return float(word)


def whole_word(word: str) -> int:
    """A whole number from zero."""
    if not word.strip().lstrip("+-").isdecimal():
        raise argparse.ArgumentTypeError(f"{word!r} is no whole number")
    if int(word) < 0:
        raise argparse.ArgumentTypeError(f"{word} is below zero")
    return int(word)


def count_word(word: str) -> int:
    """A whole number from one."""
    if whole_word(word) == 0:
        raise argparse.ArgumentTypeError("at least 1 is needed")
    return int(word)


def words(word: str) -> tuple[str, ...]:
    """Words with commas between."""
    return tuple(part.strip() for part in word.split(","))


def planes_word(word: str) -> Planes:
    """Names with commas between, or ``disk=7,journal=14``."""
    if "=" not in word:
        return words(word)
    found: dict[str, int | str] = {}
    for item in words(word):
        name, _, at = (part.strip() for part in item.partition("="))
        if not (name and at) or name in found:
            raise argparse.ArgumentTypeError(f"{item!r} is not NAME=NODE with a name of its own: disk=7,journal=14")
        found[name] = int(at) if at.isdecimal() else at
    return found


def number_word(word: str) -> float:
    """A number, refused in words otherwise."""
    try:
        return float(word)
    except ValueError:
        raise ValueError(f"{word!r} is not a number") from None


def two_numbers(word: str, low: str = "", high: str = "") -> tuple[float, float]:
    """Two numbers with a colon between; ``low`` and ``high`` in place of those that are left out."""
    first, colon, second = word.partition(":")
    if not colon:
        raise ValueError("give two numbers with a colon between")
    return number_word(first or low), number_word(second or high)


def _common_word(word: str) -> str:
    if word != "common":
        raise argparse.ArgumentTypeError(
            f"{word!r} is not allowed: give common for one angle, or nothing behind it for one a run (put files first)"
        )
    return word


def _yes_or_no(word: str) -> bool:
    if word not in ("yes", "no"):
        raise argparse.ArgumentTypeError(f"{word!r} is not allowed: give yes or no")
    return word == "yes"


def _shares_word(word: str) -> dict[str, float]:
    """``0.6*disk+0.4*journal`` as shares by plane."""
    shares: dict[str, float] = {}
    for term in filter(None, word.replace("-", "+-").split("+")):
        share, star, plane = term.partition("*")
        if not (star and plane.strip()):
            raise ValueError("give shares of planes, such as 0.6*disk+0.4*journal")
        shares[plane.strip()] = number_word(share)
    return shares


def pairs(option: str, given: Sequence[str], parse: Callable[[str], Any]) -> dict[str, Any]:
    """``NAME=VALUE`` words, several of them also in one word with commas between."""
    values: dict[str, Any] = {}
    for item in (part for word in given for part in word.split(",")):
        name, _, value = (part.strip() for part in item.partition("="))
        if not (name and value):
            raise ValueError(f"{option} takes NAME=VALUE, got {item!r}")
        if name in values:
            raise ValueError(f"{option} names {name} twice")
        try:
            values[name] = parse(value)
        except ValueError as problem:
            raise ValueError(f"{option} {item}: {problem}") from problem
    return values


# ---- kinds ------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Kind:
    """How a setting is read and written."""

    toml: Parser  # reads the value of a TOML key
    word: Callable[[str], Any] | None  # reads the word behind an option of the command line
    written: Callable[[Any], str | None]  # the word that :attr:`word` reads as this value
    paired: bool = False  # the option is ``NAME=VALUE`` and may be given again
    bare: bool = False  # the option may stand alone, which means true
    off: str = ""  # option that says none of it, which TOML does by false and Python by None


def _digits(value: Any) -> str | None:
    return f"{value:.10g}" if isinstance(value, int | float) else None


KINDS: Mapping[str, Kind] = {
    "bool": Kind(toml=flag, word=None, written=lambda value: ""),
    "bool | None": Kind(toml=flag, word=_yes_or_no, written=lambda value: "yes" if value else "no"),
    "PhaseOffsets": Kind(toml=phase_offsets, word=_common_word, written=str, bare=True),
    **dict.fromkeys(("str", "Loss", "Method"), Kind(toml=text, word=str, written=str)),
    "tuple[str, ...]": Kind(toml=_texts, word=words, written=",".join),
    "Planes": Kind(
        toml=_planes,
        word=planes_word,
        written=lambda planes: ",".join(f"{p}={planes[p]}" if isinstance(planes, Mapping) else p for p in planes),
    ),
    **dict.fromkeys(("float", "float | None"), Kind(toml=_positive, word=positive_word, written=_digits)),
    "int": Kind(toml=count, word=count_word, written=str),
    "int | None": Kind(toml=whole, word=whole_word, written=str),
    "Mapping[str, float]": Kind(toml=table(number), word=number_word, written=_digits, paired=True),
    "Mapping[str, float] | None": Kind(
        toml=lambda key, value: None if value is False else table(number)(key, value),
        word=number_word,
        written=_digits,
        paired=True,
        off="--no-causes",
    ),
    "Mapping[str, float | tuple[float, float] | None]": Kind(
        toml=table(_known), word=_known_word, written=_known_written, paired=True
    ),
    "Mapping[str, tuple[float, float]]": Kind(
        toml=table(pair),
        word=lambda word: two_numbers(word, "-inf", "inf"),
        written=lambda value: ":".join("" if math.isinf(end) else f"{end:.10g}" for end in value),
        paired=True,
    ),
    "Mapping[str, Any]": Kind(
        toml=table(prior),
        word=lambda word: _frozen_prior("prior", "norm", two_numbers(word)),
        written=lambda value: f"{value.mean():.10g}:{value.std():.10g}" if value.dist.name == "norm" else None,
        paired=True,
    ),
    "Mapping[str, str]": Kind(toml=table(text), word=str, written=str, paired=True),
    "Mapping[str, Mapping[str, float]]": Kind(
        toml=table(table(number)),
        word=_shares_word,
        written=lambda shares: "+".join(f"{share:.10g}*{plane}" for plane, share in shares.items()).replace("+-", "-"),
        paired=True,
    ),
    "Mapping[str, float | Mapping[str, float]]": Kind(
        toml=table(uncertainty), word=number_word, written=_digits, paired=True
    ),
}
"""Kind of value by the type that an option is declared with; ``Any`` is a distribution of scipy.stats."""


def written(kind: Kind, name: str, value: Any) -> list[str] | None:
    """Words of the command line that say a value of an option; ``None`` where none can."""
    if value is None:
        return [kind.off]
    if kind.word is None or (kind.bare and value is True):
        return [name]
    if not kind.paired:
        word = kind.written(value)
        return None if word is None else [name, word]
    found: list[str] = []
    for key, item in dict(value).items():
        word = kind.written(item)
        if word is None:
            return None
        found += [name, f"{key}={word}"]
    return found


def is_set(value: Any, kind: Kind | None = None) -> bool:
    """True if a setting says anything: not empty, not false, not left out; with a kind, none of it may say so."""
    if value is None and kind is not None:
        return bool(kind.off)
    if value is False:  # which is one of two answers, or none
        return kind is not None and kind.word is not None and not kind.bare
    return value is not None and not (isinstance(value, Mapping | tuple | str) and not value)
