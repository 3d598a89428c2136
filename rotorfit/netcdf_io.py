"""netCDF through xarray: every column a variable over ``row``, SI units, complex ones as real and imaginary part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.experiments import DisplacementTest, Experiment, PerturbationTest
from rotorfit.models.parameters import unknown_name

KINDS: dict[str, type[Any]] = {kind.__name__: kind for kind in (PerturbationTest, DisplacementTest)}
"""Experiments that can be stored column by column, by the name that goes into the file."""

_UNITS = {
    "speed": "rad/s",
    "frequency": "rad/s",
    "force": "N",
    "force_x": "N",
    "force_y": "N",
    "response": "m or rad, 0-peak",
    "displacement": "m, 0-peak",
}
_TYPES = {"Text": str, "Float": float, "ComplexArray": complex}


def column_types(kind: type[Any]) -> dict[str, type]:
    """Columns of an experiment class and whether they are text, real or complex."""
    return {f.name: _TYPES[str(f.type)] for f in fields(kind) if f.name not in ("source", "attributes")}


def build(kind: str, columns: Mapping[str, Any], attributes: Mapping[str, Any], source: str) -> Experiment:
    """Make an experiment of stored columns.

    Raises:
        ValueError: unknown kind, missing columns, a column of the wrong type or length.
    """
    if kind not in KINDS:
        raise ValueError(f"{source}: {unknown_name('kind of experiment', kind, KINDS)}")
    types = column_types(KINDS[kind])
    missing = [name for name in types if name not in columns]
    if missing:
        raise ValueError(
            f"{source}: missing columns: {', '.join(missing)}. The file has: {', '.join(columns) or 'none'}"
        )
    arrays = {name: _convert(source, name, columns[name], kind_of) for name, kind_of in types.items()}
    experiment: Experiment = KINDS[kind](**arrays, attributes=dict(attributes), source=source)
    return experiment


def _convert(source: str, name: str, values: Any, kind: type) -> NDArray[Any]:
    array = np.asarray(values)
    allowed = {str: "UO", float: "iuf", complex: "iufc"}[kind]
    if array.dtype.kind not in allowed or array.ndim != 1:
        raise ValueError(
            f"{source}: column {name!r} should be a list of {kind.__name__} values, it is {array.dtype} of shape "
            f"{array.shape}"
        )
    return array.astype(kind)


def write_netcdf(experiment: Experiment, path: str | Path) -> None:
    """Write an experiment to netCDF (HDF5), exact to the last bit.

    Variables carry the names of the columns; ``force`` becomes ``force_real`` and ``force_imag`` and so on. Attributes
    become ``attribute_1`` ... with their name in ``long_name``, since netCDF does not allow all names.
    """
    import xarray as xr

    variables: dict[str, Any] = {}
    for name, kind in column_types(type(experiment)).items():
        values = getattr(experiment, name)
        units = {"units": _UNITS[name]} if name in _UNITS else {}
        if kind is complex:
            variables[f"{name}_real"] = ("row", values.real, units)
            variables[f"{name}_imag"] = ("row", values.imag, units)
        else:
            variables[name] = ("row", values.astype(object) if kind is str else values, units)
    for number, (name, values) in enumerate(experiment.attributes.items(), 1):
        stored = values.astype(object) if values.dtype.kind == "U" else values
        variables[f"attribute_{number}"] = ("row", stored, {"long_name": name})
    header = {"title": "rotorfit experiment", "kind": type(experiment).__name__}
    xr.Dataset(variables, attrs=header).to_netcdf(path, engine="h5netcdf")


def read_netcdf(path: str | Path) -> Experiment:
    """Read an experiment written by :func:`write_netcdf`, or by others with the same variables.

    Raises:
        ValueError: not a netCDF file, or one without the variables of an experiment.
        FileNotFoundError: no such file.
    """
    import xarray as xr

    Path(path).stat()  # a missing file is reported by its own exception
    source = Path(path).name
    try:
        with xr.open_dataset(path, engine="h5netcdf", decode_times=False) as dataset:
            data = dataset.load()
    except Exception as error:  # whatever the HDF5 stack raises on a damaged file
        raise ValueError(f"{source} is not a readable netCDF file (HDF5): {error}") from error
    columns: dict[str, Any] = {}
    attributes: dict[str, Any] = {}
    for name, variable in data.variables.items():
        values = variable.values
        if str(name).startswith("attribute_"):
            label = str(variable.attrs.get("long_name", name))
            attributes[label] = values.astype(str) if values.dtype.kind == "O" else values
        elif str(name).endswith("_real") and f"{name[:-5]}_imag" in data:
            columns[str(name)[:-5]] = values + 1j * data[f"{name[:-5]}_imag"].values
        else:
            columns[str(name)] = values
    return build(str(data.attrs.get("kind", "PerturbationTest")), columns, attributes, source)
