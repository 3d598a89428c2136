"""netCDF through xarray: every column a variable over ``row``, SI units, complex ones as real and imaginary part."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rotorfit.base.file_reading import check_hdf5, check_seal, is_sealed, reading, refuse_deadly, seal, shown
from rotorfit.base.names import unknown_name
from rotorfit.base.units import find_unit, units_of
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.io.columns import build, column_types, shown_words

if TYPE_CHECKING:
    import xarray as xr

_UNITS = {
    "speed": "rad/s", "frequency": "rad/s", "force": "N", "force_x": "N", "force_y": "N", "load": "N",
    "response": "m or rad, 0-peak", "displacement": "m, 0-peak", "position": "m", "x": "m", "y": "m", "time": "s",
    "eccentricity": "1", "damping_ratio": "1",
    "kxx": "N/m", "kxy": "N/m", "cxx": "N s/m", "cxy": "N s/m", "mxx": "kg",
}  # fmt: skip
"""Units that are written, by column."""

_PLACES = ("speed", "frequency", "time")
"""Columns of numbers that say where a reading is."""

_QUANTITIES = {
    "speed": ("frequency",), "frequency": ("frequency",),
    "force": ("force",), "force_x": ("force",), "force_y": ("force",), "load": ("force",),
    "response": ("displacement", "tilt"), "displacement": ("displacement",), "position": ("length",),
    "x": ("length",), "y": ("length",), "sigma": ("displacement", "tilt", "force"),
}  # fmt: skip
"""Quantities that may be read in other units, by column."""


def write_netcdf(experiment: Experiment, path: str | Path) -> None:
    """Write an experiment to netCDF (HDF5), exact to the last bit.

    Variables carry the names of the columns; ``force`` becomes ``force_real`` and ``force_imag`` and so on. Attributes
    become ``attribute_1`` ... with their name in ``long_name``, since netCDF does not allow all names.
    """
    import xarray as xr

    experiment = experiment.stored_rows()
    variables: dict[str, Any] = {}
    for name, kind in column_types(experiment).items():
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
    content = BytesIO()  # the HDF5 library ends the process where a disk is full
    write_dataset(xr.Dataset(variables, attrs=header), content)
    Path(path).write_bytes(content.getbuffer())
    seal(Path(path))


def to_xarray(experiment: Experiment) -> xr.Dataset:
    """See :meth:`Experiment.to_xarray`."""
    import xarray as xr

    experiment = experiment.stored_rows()
    data: dict[str, Any] = {}
    where: dict[str, Any] = {name: ("reading", values) for name, values in experiment.attributes.items()}
    for name, kind in column_types(experiment).items():
        told = {"units": _UNITS[name]} if name in _UNITS else {}
        (where if kind is str or name in _PLACES else data)[name] = ("reading", getattr(experiment, name), told)
    return xr.Dataset(data, where, {"title": experiment.source, "kind": type(experiment).__name__})


def write_dataset(dataset: xr.Dataset, content: BytesIO, **options: Any) -> None:
    """Write a data set into memory. Beside a Dask client, or on one's worker, xarray would lock by the cluster, which
    refuses what is no file: the lock of this process will do."""
    dask = sys.modules.get("dask")
    with nullcontext() if dask is None else dask.config.set(scheduler=dask.get):  # by its name it would warn
        dataset.to_netcdf(content, engine="h5netcdf", **options)


def load_dataset(path: Path, group: str | None = None) -> xr.Dataset:
    """A data set of a file, netCDF 4 (HDF5) or classic netCDF 3, as it was written."""
    import h5py
    import xarray as xr

    with path.open("rb") as stream:
        classic = stream.read(3) == b"CDF"
    with reading(path.name, "netCDF file"):
        check_seal(path, path.name)
        if not classic:
            if not is_sealed(path):
                refuse_deadly(path)
            check_hdf5(path)
        if group is not None:
            with nullcontext({}) if classic else h5py.File(path) as file:
                if group not in file:
                    raise ValueError(f"{path.name} holds no {group}")
        engine = "scipy" if classic else "h5netcdf"
        with xr.open_dataset(path, group=group, engine=engine, decode_times=False) as stored:
            return stored.load()


def read_netcdf(path: str | Path) -> Experiment:
    """Read an experiment written by :func:`write_netcdf`, or by others with the same variables.

    A variable without the attribute ``units`` is SI; any unit of :data:`rotorfit.base.units.UNITS` is converted. The
    file may be netCDF 4 (HDF5) or classic netCDF 3.
    """
    source, data = Path(path).name, load_dataset(Path(path))
    columns: dict[str, Any] = {}
    attributes: dict[str, Any] = {}
    for key in data.variables:
        name, variable, values = str(key), data[key], data[key].values
        if values.dtype.kind in "OS":
            values = values.astype(str)
        values = shown_words(values)
        if name.startswith("attribute_"):
            attributes[shown(str(variable.attrs.get("long_name", name)))] = values
        elif name.endswith("_real") and f"{name[:-5]}_imag" in data:
            imaginary = data[f"{name[:-5]}_imag"]
            parts = values * _factor(source, variable), imaginary.values * _factor(source, imaginary)
            columns[name[:-5]] = parts[0] + 1j * parts[1]
        elif not (name.endswith("_imag") and f"{name[:-5]}_real" in data):
            columns[name] = values if values.dtype.kind == "U" else values * _factor(source, variable)
    return build(str(data.attrs.get("kind", "PerturbationTest")), columns, attributes, source)


def _factor(source: str, variable: Any) -> float:
    """Factor to SI of a variable, from its attribute ``units``; 1 for what is no column of an experiment."""
    name = str(variable.name)
    column = name.removesuffix("_real").removesuffix("_imag")
    label = str(variable.attrs.get("units", ""))
    if label in ("", _UNITS.get(column)) or column not in _UNITS.keys() | _QUANTITIES.keys():
        return 1.0
    if column not in _QUANTITIES:
        raise ValueError(f"{source}: variable {name!r} is in {label!r}; needed is {_UNITS[column]!r}")
    units = units_of(*_QUANTITIES[column])
    try:
        factor = find_unit(label.partition(",")[0].strip().replace("/", "_"), units)
    except ValueError as reason:
        raise ValueError(f"{source}: variable {name!r}: {reason}") from reason
    if factor is None:
        raise ValueError(f"{source}: variable {name!r}: {unknown_name('unit', label, units)}")
    return factor
