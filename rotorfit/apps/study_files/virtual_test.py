"""Tests of a virtual rig as TOML files: every key checked, relative paths relative to the file.

::

    model = "one-mode"
    law = "muszynska"
    clearance_um = 200
    noise = 0.02                        # over the rms reading of a run; of files of vectors
    seed = 1

    [params]                            # true values, SI units
    M = 1.2
    K0 = 9000

    [test]                              # the options that the kind has in Python
    kind = "perturbation"
    speed_rpm = 600
    frequency_rpm = {from = -1600, to = 1600, count = 16}
    force = [0.2, 0.6, 1.2]

What a kind takes, and what its values must be, its function says: one of
:data:`rotorfit.lab.simulation.simulate.SIMULATED` or :data:`rotorfit.lab.simulation.recordings.RECORDED`.
"""

from __future__ import annotations

import cmath
import inspect
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rotorfit.apps.study_files.study import Study, build_model
from rotorfit.apps.study_files.study_file import known_keys, read_keys, refuse_unknown
from rotorfit.base.atomic_file import joined
from rotorfit.base.names import unknown_name
from rotorfit.identify.options.kinds import Parser, count, flag, number, numbers, one_or_more, pair, table, text, whole
from rotorfit.identify.options.table import FIT, LAW, MODEL
from rotorfit.lab.simulation.instruments import Instruments
from rotorfit.lab.simulation.recordings import RECORDED
from rotorfit.lab.simulation.simulate import options_of
from rotorfit.models import RotorModel

_DOWNWARDS = -90.0
"""Direction of a load unless given, degrees from x towards y."""


def read_virtual_test(path: str | Path, kinds: Mapping[str, Callable[..., Any]]) -> dict[str, Any]:
    """Arguments of :func:`rotorfit.simulate` or :func:`rotorfit.simulate_recordings` from a TOML file.

    Args:
        path: the file.
        kinds: the kinds of tests that there are, with their functions.

    Raises:
        ValueError: a key or a kind that there is not, a value that it cannot have, a key that the kind needs.
    """
    return read_keys(path, partial(_arguments, kinds=kinds))


def _arguments(content: Mapping[str, Any], base: Path, *, kinds: Mapping[str, Callable[..., Any]]) -> dict[str, Any]:
    recorded = kinds is RECORDED
    keys: dict[str, Parser] = {**_MODEL, "params": table(number), "test": _table, "seed": whole}
    keys["turbulence" if recorded else "noise"] = number
    content = known_keys(content, keys)
    for key in ("model", "params", "test"):
        if key not in content:
            raise ValueError(f"the key {key!r} is missing")
    found: dict[str, Any] = {key: keys[key](key, value) for key, value in content.items()}
    model = _model({name: found.pop(name) for name in _MODEL if name in found}, base)
    test = found.pop("test")
    kind = text("test.kind", test.pop("kind", "perturbation"))
    if kind not in kinds:
        raise ValueError(unknown_name(f"kind of {'recorded ' if recorded else ''}test", kind, kinds))
    if recorded and "sampling_hz" in test:
        found["instruments"] = Instruments(sample_rate=number("test.sampling_hz", test.pop("sampling_hz")))
    return {"model": model, "kind": kind, **found, **_options(kind, test, kinds)}


def _model(settings: Mapping[str, Any], base: Path) -> RotorModel:
    """The model of the virtual rig."""
    if settings["model"] == "anisotropic" and not settings.get("planes"):
        raise ValueError("anisotropic has as many planes as the key 'planes' names: give them")
    study = Study(files=(), **settings)
    return build_model(replace(study, structure=str(joined(base, study.structure))) if study.structure else study, ())


def _options(kind: str, given: Mapping[str, Any], kinds: Mapping[str, Callable[..., Any]]) -> dict[str, Any]:
    """The options of a kind; what it does not have, or lacks, is refused."""
    needed, signature = options_of(kind, kinds), inspect.signature(kinds[kind])
    size_alone = "load" in needed and "load_deg" not in needed  # a complex number in Python
    allowed = [*needed, *(["load_deg"] if size_alone else [])]
    refuse_unknown(given, allowed, f"key of [test] of kind {kind}")
    for name in (name for name, must in needed.items() if must and name not in given):
        raise ValueError(f"[test] of kind {kind} needs {name}; its keys are {', '.join(allowed)}")
    degrees = number("test.load_deg", given.get("load_deg", _DOWNWARDS))
    named = [name for name in given if name in needed]
    found = {name: PARSERS[signature.parameters[name].annotation](f"test.{name}", given[name]) for name in named}
    if size_alone and "load" in found:
        found["load"] *= cmath.exp(1j * math.radians(degrees))
    return found


def _table(key: str, value: Any) -> dict[str, Any]:
    """A table, whose values are read when its kind is known."""
    read: dict[str, Any] = table(lambda _, item: item)(key, value)
    return read


def _number_or_table(key: str, value: Any) -> Any:
    return table(number)(key, value) if isinstance(value, dict) else number(key, value)


_texts = one_or_more(text)
PARSERS: dict[str, Parser] = {
    "ArrayLike": numbers,
    "complex | Sequence[complex] | None": numbers,
    "Sequence[float]": numbers,
    "float": number,
    "float | None": number,
    "complex": number,
    "float | Mapping[str, float]": _number_or_table,
    "Mapping[str, complex] | None": table(number),
    "tuple[float, float]": pair,
    "int": count,
    "bool": flag,
    "str | None": text,
    "LineOrder": text,
    "str | Sequence[str] | None": _texts,
    "Sequence[str]": _texts,
}
"""What a value must be, by the type that the function of a kind gives it."""
_MODEL: dict[str, Parser] = {"model": text, **{name: FIT[name].kind.toml for name in (*MODEL, *LAW)}}
