"""Arrays, frozen distributions and rotorfit's own records as plain JSON values, and back; exact, and without pickle.

A float is written with the shortest digits that read back as the same float. What JSON lacks is an object with one of
the keys ``array``, ``complex``, ``float``, ``tuple``, ``mapping``, ``distribution``, ``record``, ``model``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, fields, is_dataclass
from functools import cache
from importlib import import_module
from inspect import isabstract
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.file_reading import check_text, shown
from rotorfit.estimators.inference.cause_acts import Act
from rotorfit.models import RotorModel

_HOMES = (
    "rotorfit.lab.data.experiments",
    "rotorfit.lab.data.findings",
    "rotorfit.lab.kinds.coefficient_table",
    "rotorfit.lab.kinds.displacement_test",
    "rotorfit.lab.kinds.free_vibration",
    "rotorfit.lab.kinds.line_test",
    "rotorfit.lab.kinds.operating_test",
    "rotorfit.lab.kinds.static_test",
    "rotorfit.models",
    "rotorfit.identify.fitting.result",
    "rotorfit.identify.fitting.settings",
    "rotorfit.identify.fitting.causes.calibration",
    "rotorfit.identify.fitting.noise.record",
    "rotorfit.identify.fitting.noise.residual_study",
    "rotorfit.estimators.inference.identifiability",
    "rotorfit.estimators.inference.cause_acts",
    "rotorfit.estimators.inference.causes",
    "rotorfit.estimators.inference.joint_errors",
    "rotorfit.identify.fitting.causes.solution",
    "rotorfit.models.motion.neglected_terms",
)
"""Modules whose records a file may name; nothing else is ever imported or called for a file."""

_KINDS = {"f": "float64", "c": "complex128", "i": "int64", "b": "bool", "U": "str", "O": "object"}


class UserDefinedError(ValueError):
    """A value is of a class that rotorfit does not have, so that a file cannot say how to make it again."""


def encode(value: Any) -> Any:
    """A value as JSON's own types."""
    if value is None or isinstance(value, (str, bool)):
        return value
    for kinds, writer in _WRITERS:
        if isinstance(value, kinds):
            return writer(value)
    if is_dataclass(value) and not isinstance(value, type):
        return _encode_own(value)
    if hasattr(value, "logpdf") and hasattr(value, "dist"):
        return _encode_distribution(value)
    raise ValueError(f"a {type(value).__name__} cannot be written to a file: {value!r}")


def decode(value: Any) -> Any:
    """The value that :func:`encode` was given."""
    if isinstance(value, list):
        return [decode(item) for item in value]
    if not isinstance(value, dict):
        return shown(value) if isinstance(value, str) else value
    for key in value:
        if key in _READERS:
            return _READERS[key](value)
    raise ValueError(f"unknown kind of value, with {', '.join(map(str, value)) or 'no entries'}")


# ---- numbers and arrays ----------------------------------------------------------------------------------------------


def _encode_float(value: Any) -> Any:
    return float(value) if math.isfinite(value) else {"float": str(float(value))}


def _encode_array(array: NDArray[Any]) -> Any:
    if array.dtype.kind not in _KINDS:
        raise ValueError(f"an array of {array.dtype} cannot be written to a file; give numbers, truth values or text")
    flat = array.ravel()
    if array.dtype.kind == "O":
        return {"array": "object", "shape": list(array.shape), "data": [encode(item) for item in flat.tolist()]}
    if array.dtype.kind == "c":
        flat = flat.astype(complex).view(float)
    if array.dtype.kind in "fc":
        data = [v if math.isfinite(v) else str(v) for v in flat.astype(float).tolist()]
    else:
        data = flat.tolist()
    return {"array": _KINDS[array.dtype.kind], "shape": list(array.shape), "data": data}


def _decode_array(value: Mapping[str, Any]) -> NDArray[Any]:
    kind, shape, data = value["array"], tuple(value["shape"]), value["data"]
    if kind not in _KINDS.values():
        raise ValueError(f"array of unknown kind {kind!r}; there are {', '.join(_KINDS.values())}")
    if kind == "str":
        data = [shown(str(item)) for item in data]
        check_text("an array", data)
    try:
        if kind == "object":
            return np.fromiter(map(decode, data), dtype=object).reshape(shape)
        if kind == "complex128":
            return np.array(data, dtype=float).view(complex).reshape(shape)
        return np.array(data, dtype=kind).reshape(shape)
    except ValueError as reason:
        raise ValueError(f"array of shape {shape} with {len(data)} entries of {kind}: {reason}") from reason


# ---- distributions ---------------------------------------------------------------------------------------------------


def _family(name: Any) -> Any:
    """The continuous distribution of scipy.stats of that name, None where there is none."""
    from scipy import stats

    found = getattr(stats, name, None) if isinstance(name, str) else None
    return found if isinstance(found, stats.rv_continuous) else None


def _encode_distribution(frozen: Any) -> Any:
    name = frozen.dist.name
    if type(_family(name)) is not type(frozen.dist):
        raise ValueError(f"the prior {name!r} is not a continuous distribution of scipy.stats: a file cannot hold it")
    kwds = {key: encode(item) for key, item in frozen.kwds.items()}
    return {"distribution": name, "args": [encode(a) for a in frozen.args], "kwds": kwds}


def _decode_distribution(value: Mapping[str, Any]) -> Any:
    family = _family(value["distribution"])
    if family is None:
        raise ValueError(f"scipy.stats has no continuous distribution {value['distribution']!r}")
    return family(*map(decode, value["args"]), **{key: decode(item) for key, item in value["kwds"].items()})


# ---- records and models ----------------------------------------------------------------------------------------------


def _home(name: Any) -> Any:
    """The class of a name in one of the homes, None if there is none."""
    return _class_of(name) if isinstance(name, str) else None


@cache
def _class_of(name: str) -> Any:
    for module in _HOMES:
        found = getattr(import_module(module), name, None)
        if isinstance(found, type) and (is_dataclass(found) or issubclass(found, RotorModel)):
            return found
    return None


def _encode_own(value: Any) -> Any:
    """A record or a model, by the name of its class."""
    name, what = type(value).__name__, "model" if isinstance(value, RotorModel) else "class"
    if _home(name) is not type(value):
        raise UserDefinedError(f"{name} is not a {what} of rotorfit: a file cannot say how to make it again")
    if isinstance(value, RotorModel):
        return {"model": name, "options": {key: encode(option) for key, option in value.options().items()}}
    return {"record": name, "fields": {f.name: encode(getattr(value, f.name)) for f in fields(value) if f.init}}


def _decode_record(value: Mapping[str, Any]) -> Any:
    kind = _home(value["record"])
    if kind is None or not is_dataclass(kind) or isabstract(kind):
        raise ValueError(f"this version of rotorfit has no record {value['record']!r}")
    given = value["fields"]
    known = {f.name: f for f in fields(kind) if f.init}
    unknown = sorted(set(given) - set(known))
    missing = [n for n, f in known.items() if n not in given and f.default is MISSING and f.default_factory is MISSING]
    if unknown or missing:
        what = [f"unknown entries {', '.join(unknown)}"] * bool(unknown) + [f"no {', '.join(missing)}"] * bool(missing)
        raise ValueError(f"record {value['record']} has {' and '.join(what)}")
    entries = {name: decode(item) for name, item in given.items()}
    check_types(kind, entries, f"record {value['record']}: ")
    record: Any = kind
    return record(**entries)


def check_types(kind: Any, entries: Mapping[str, Any], where: str = "") -> None:
    """Refuse values for the fields of a record that are not what these are annotated with."""
    for field in fields(kind):
        if field.name in entries and not _is_of(entries[field.name], str(field.type)):
            raise ValueError(f"{where}{field.name} must be of type {field.type}, got {entries[field.name]!r}")


_PLAIN = {"float": (int, float), "int": (int,), "bool": (bool,), "str": (str,), "complex": (int, float, complex)} | {
    "None": (type(None),)
}
"""Classes of the values of fields that are annotated so."""
_ARRAYS = {
    "Float": "fiub",
    "ComplexArray": "cfiub",
    "Bool": "b",
    "Index": "iu",
    "Text": "UO",
    "Records": "O",
    "NDArray": "fiubcU",
}
"""Kinds of the numbers of arrays that are annotated so."""
_SEVERAL = {
    "Terms": "tuple[tuple[complex, int, int], ...]",
    "Entries": "tuple[tuple[int, int, float], ...]",
    "Uncertainty": "float | Mapping[str, float]",
    "PhaseOffsets": "bool | str",
    "Loss": "str",
    "Method": "str",
}
"""Annotations that stand for others."""


def _is_of(value: Any, annotation: str) -> bool:
    """True if a value is what a field is annotated with, as far as that is known here."""
    return any(_is_one(value, one) for one in _parts(_SEVERAL.get(annotation, annotation), "|"))


def _is_one(value: Any, annotation: str) -> bool:
    name, _, rest = annotation.partition("[")
    inside = _parts(rest.removesuffix("]"), ",")
    if name in _PLAIN:
        return isinstance(value, _PLAIN[name]) and (name == "bool" or not isinstance(value, bool))
    if name in _ARRAYS:
        of_rows = name != "Records" or all(_is_of(row, "tuple[tuple, ...]") for row in np.ravel(value))
        return isinstance(value, np.ndarray) and value.dtype.kind in _ARRAYS[name] and of_rows
    if name == "tuple" and not rest:
        return isinstance(value, tuple)
    if name == "tuple":
        kinds = (inside[0],) * len(value) if inside[-1] == "..." and isinstance(value, tuple) else inside
        return isinstance(value, tuple) and len(value) == len(kinds) and all(map(_is_of, value, kinds))
    if name == "Mapping":
        return isinstance(value, Mapping) and all(
            _is_of(k, inside[0]) and _is_of(v, inside[1]) for k, v in value.items()
        )
    kind = Act if name == "Act" else _home(name)  # several records act in one way or another
    return kind is None or isinstance(value, kind)


@cache
def _parts(annotation: str, mark: str) -> tuple[str, ...]:
    """Pieces of an annotation between marks that stand in no brackets."""
    found, depth = [""], 0
    for letter in annotation:
        depth += (letter == "[") - (letter == "]")
        if letter == mark and not depth:
            found.append("")
        else:
            found[-1] += letter
    return tuple(piece.strip() for piece in found)


def _decode_model(value: Mapping[str, Any]) -> RotorModel:
    kind = _home(value["model"])
    if kind is None or not issubclass(kind, RotorModel):
        raise ValueError(f"this version of rotorfit has no model {value['model']!r}")
    options = {name: decode(option) for name, option in value["options"].items()}
    try:
        return kind(**options)  # type: ignore[no-any-return]
    except TypeError as reason:
        raise ValueError(f"the model {value['model']} cannot be made with {', '.join(options)}: {reason}") from reason


_WRITERS: tuple[tuple[Any, Callable[[Any], Any]], ...] = (
    (np.bool_, bool),
    ((int, np.integer), int),
    ((float, np.floating), _encode_float),
    ((complex, np.complexfloating), lambda value: {"complex": [_encode_float(value.real), _encode_float(value.imag)]}),
    (np.ndarray, _encode_array),
    (RotorModel, _encode_own),
    (Mapping, lambda value: {"mapping": [[encode(key), encode(item)] for key, item in value.items()]}),
    (tuple, lambda value: {"tuple": [encode(item) for item in value]}),
    (list, lambda value: [encode(item) for item in value]),
)
_READERS: dict[str, Callable[[Any], Any]] = {
    "float": lambda value: float(value["float"]),
    "complex": lambda value: complex(*map(decode, value["complex"])),
    "array": _decode_array,
    "distribution": _decode_distribution,
    "record": _decode_record,
    "model": _decode_model,
    "mapping": lambda value: {decode(key): decode(item) for key, item in value["mapping"]},
    "tuple": lambda value: tuple(decode(item) for item in value["tuple"]),
}
