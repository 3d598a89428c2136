"""Experiments as stored columns, whatever the format: which there are, and building an experiment of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.file_reading import shown
from rotorfit.base.names import unknown_name
from rotorfit.estimators.blocks.row_keys import words
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import NO_COLUMNS, Experiment
from rotorfit.lab.kinds.coefficient_table import CoefficientTable
from rotorfit.lab.kinds.displacement_test import DisplacementTest
from rotorfit.lab.kinds.free_vibration import ImpulseTest, RingDownTest
from rotorfit.lab.kinds.line_test import LineTest
from rotorfit.lab.kinds.operating_test import OperatingTest
from rotorfit.lab.kinds.static_test import StaticTest

_KINDS = (
    PerturbationTest,
    DisplacementTest,
    StaticTest,
    ImpulseTest,
    RingDownTest,
    CoefficientTable,
    LineTest,
    OperatingTest,
)
STORABLE: dict[str, type[Any]] = {kind.__name__: kind for kind in _KINDS}
"""Experiments that can be stored column by column, by the name that goes into the file."""

_TYPES = {"Text": str, "Float": float, "ComplexArray": complex}


def column_types(kind: Experiment | type[Experiment]) -> dict[str, type]:
    """Columns of an experiment, or of its class, and whether they are text, real or complex."""
    no_columns = (*NO_COLUMNS, "further_forces")
    return {f.name: _TYPES[str(f.type)] for f in fields(kind) if f.name not in no_columns}


def build(kind: str, columns: Mapping[str, Any], attributes: Mapping[str, Any], source: str) -> Experiment:
    """Make an experiment of stored columns.

    Single values stand for all rows. ``sigma`` may be missing, which is unknown noise, and ``force_direction``, which
    is a circular force. What is no column but a list of the same length, or a single value, becomes an attribute;
    anything else is not of this experiment and left out.
    """
    if kind not in STORABLE:
        raise ValueError(f"{source}: {unknown_name('kind of experiment', kind, STORABLE)}")
    types = column_types(STORABLE[kind])
    optional = {"sigma": np.array(np.nan), "force_direction": np.array("circular")}
    missing = [name for name in types if name not in columns and name not in optional]
    if missing:
        raise ValueError(
            f"{source}: missing columns: {', '.join(missing)}. The file has: {', '.join(columns) or 'none'}"
        )
    given = {**optional, **columns}
    arrays = {name: _convert(source, name, given[name], kind_of) for name, kind_of in types.items()}
    size = max(array.size for array in arrays.values())
    extra = {name: np.asarray(values) for name, values in columns.items() if name not in types}
    extra = {name: values for name, values in extra.items() if values.shape in ((), (1,), (size,))}
    try:
        experiment: Experiment = STORABLE[kind](
            **{name: _spread(values, size) for name, values in arrays.items()},
            attributes={name: _spread(values, size) for name, values in (extra | dict(attributes)).items()},
            source=source,
        )
        return experiment.from_stored_rows()
    except ValueError as error:
        raise ValueError(str(error) if str(error).startswith(source) else f"{source}: {error}") from error


def shown_words(column: NDArray[Any]) -> NDArray[Any]:
    """A column whose texts can be shown; numbers as they are."""
    if column.dtype.kind != "U":
        return column
    names, number = words(column.reshape(-1))
    return np.array([shown(name) for name in names], dtype=str)[number].reshape(column.shape)


def _spread(values: NDArray[Any], size: int) -> NDArray[Any]:
    return np.broadcast_to(values, (size,)).copy() if values.size == 1 else values


def _convert(source: str, name: str, values: Any, kind: type) -> NDArray[Any]:
    array = np.asarray(values)
    allowed = {str: "UO", float: "iuf", complex: "iufc"}[kind]
    if array.dtype.kind not in allowed or array.ndim > 1:
        what = {str: "text", float: "numbers", complex: "complex numbers"}[kind]
        raise ValueError(
            f"{source}: column {name!r} should be a list of {what}, it is of type {array.dtype} and shape {array.shape}"
        )
    return array.astype(kind)
