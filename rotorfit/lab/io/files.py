"""Read and write experiments; the suffix of the file tells the format."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np

from rotorfit.base.array_types import Index
from rotorfit.base.atomic_file import note_input, refuse_input, whole_file
from rotorfit.base.file_reading import reading
from rotorfit.base.units import RAD_S_PER_RPM, in_rad_s
from rotorfit.estimators.blocks.set_speeds import SPEED_TOLERANCE
from rotorfit.estimators.misfit.parameter_space import LARGEST
from rotorfit.lab.data.casing import with_casing
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.findings import Finding, listed, warn_of
from rotorfit.lab.data.probes import (
    Channel,
    check_channels,
    correct_channels,
    resolve_probe_angles,
    subtract_measured_slow_roll,
)
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.data.selection import Wanted, selected, without
from rotorfit.lab.data.stator import without_stator
from rotorfit.lab.data.synchronous import uneven_weights
from rotorfit.lab.data.weights import difference_unless_solved
from rotorfit.lab.io.other_formats import unread_suffix
from rotorfit.lab.io.tables.cells import EXCEL
from rotorfit.lab.io.tables.json_records import SUFFIXES as JSON

if TYPE_CHECKING:
    from pandas import DataFrame

_LOG = logging.getLogger(__name__)
SUFFIXES = {".csv": "csv", ".txt": "csv", ".tsv": "csv", ".uff": "uff", ".unv": "uff", ".nc": "netcdf", ".mat": "mat"}
"""Format by suffix of the file."""
RECORDINGS = (".h5", ".hdf5", ".hdf", ".tdms", ".wav", ".parquet", ".npz", ".uf58", ".lvm")
"""Suffixes that only recordings of raw signals have."""


READ_ONLY = (*EXCEL, *JSON)
"""Suffixes of tables that are not written."""


class ReadKeywords(TypedDict, total=False):
    """Options of :func:`read`, for functions that hand them on."""

    gains: Mapping[Channel, complex] | None
    delays: Mapping[Channel, float] | None
    slow_roll: Mapping[Channel, complex] | None
    slow_roll_below_rpm: float | None
    probe_angles: Mapping[str, tuple[float, float]] | None
    difference: bool
    speed: float | None
    speed_rpm: float | None
    speed_tolerance: float
    sheet: str | None
    columns: Mapping[str, str] | None
    constants: Mapping[str, str | float] | None
    axes: str
    where: Mapping[str, Wanted] | None
    exclude: Mapping[str, Wanted] | None
    drop_near_1x: float
    casing: Mapping[str, str] | None
    stator: Mapping[str, float] | None
    skip: Sequence[int]
    on_lines: Callable[[Index], None] | None
    progress: Callable[[float], None] | None


def read(
    path: str | Path | DataFrame,
    *,
    gains: Mapping[Channel, complex] | None = None,
    delays: Mapping[Channel, float] | None = None,
    slow_roll: Mapping[Channel, complex] | None = None,
    slow_roll_below_rpm: float | None = None,
    probe_angles: Mapping[str, tuple[float, float]] | None = None,
    difference: bool = True,
    speed: float | None = None,
    speed_rpm: float | None = None,
    speed_tolerance: float = SPEED_TOLERANCE,
    sheet: str | None = None,
    columns: Mapping[str, str] | None = None,
    constants: Mapping[str, str | float] | None = None,
    axes: str = "xy",
    where: Mapping[str, Wanted] | None = None,
    exclude: Mapping[str, Wanted] | None = None,
    drop_near_1x: float = 0.0,
    casing: Mapping[str, str] | None = None,
    stator: Mapping[str, float] | None = None,
    skip: Sequence[int] = (),
    on_lines: Callable[[Index], None] | None = None,
    progress: Callable[[float], None] | None = None,
    kind: type[Experiment] | None = None,
) -> Experiment:
    """Read a test: CSV (.csv .tsv .txt), Excel (.xlsx .xlsm), JSON, universal file (.uff .unv), netCDF (.nc) or MAT.

    Corrections are applied in the order of the arguments, before synchronous runs are differenced; a selection comes
    first of all. Units of a table are in its column names; what is read is SI. A table is tidy (a row a reading) or
    wide (a column a probe: ``journal_x_um``, ``journal_x_lag_deg``), or an export of a condition-monitoring system.

    Args:
        path: the file, or a pandas DataFrame with the columns of a table.
        gains: complex factor by which each channel multiplied its signal; readings are divided by it.
        delays: time by which each channel delayed its signal, s; phases are advanced by ``|w| tau``.
        slow_roll: run-out of each channel, m (rad for slopes), subtracted from once-per-turn readings.
        slow_roll_below_rpm: take the run-out of each channel and run from the readings below this speed instead.
        probe_angles: where the probes named x and y sit, degrees from X towards Y, for planes where that is not
            (0, 90): ``{"journal": (45, 135)}``.
        difference: difference the runs of a synchronous test, see :func:`rotorfit.difference_synchronous`. Runs that
            dwell at a few speeds with repeats, reference runs or weights at odd angles stay as they are: a fit solves
            them together, see :func:`rotorfit.influence`.
        speed: rotative speed, rad/s, for universal files that do not hold it.
        speed_rpm: the same in rpm.
        speed_tolerance: fraction within which speeds go by one name, ``speed_rpm``; the model of a perturbation has the
            speed of each line as it was logged, other tests their mean.
        sheet: name of the sheet of an Excel file, by default the first.
        columns: columns of a table under the names that rotorfit knows, ``{"Ampl. 1X": "journal_x_um_pp"}``; in a
            sample table of a condition-monitoring system its channels, ``{"Gearbox": "gear_x"}``.
        constants: columns that a table does not have, with one value throughout, ``{"force_plane": "journal"}``.
        axes: which directions of a universal file are x and y; ``"yz"`` for a shaft along its x axis.
        where, exclude, drop_near_1x: readings to keep, :func:`rotorfit.lab.data.selection.selected`.
        casing: plane of the sensors on a casing by plane of the rotor whose probes it holds,
            ``{"journal": "housing"}``: readings become absolute, relative motion plus that of the casing.
        stator: plane of accelerometers on a floating stator and its mass, kg, ``{"housing": 13.6}``: forces become
            F - M a.
        skip: numbers of readings to leave out, counted from 1 in the test as it is read without this option.
        on_lines: called with the line of the file, or row of the sheet, of each reading of a table, shape ``(R,)``,
            before readings are chosen by ``where`` and the like.
        progress: called with the share of a table that is read.
        kind: class of the test, such as ``rf.StaticTest``; a file that holds another is refused, and type checkers know
            what is read. By default what the file holds.

    Returns:
        the test; what was left out of a table, such as empty readings, is in its ``findings`` and is warned of.

    Raises:
        ValueError: what in the file or in an option is wrong, where, and what is allowed.
        FileNotFoundError: no such file.

    Example:
        >>> test = rf.read(rf.datasets.path("rig_open.csv"))
        >>> test.planes
        ('disk', 'journal')
    """
    if not 0 <= speed_tolerance < 1:
        raise ValueError(f"speed_tolerance is a fraction of the speed, 0 to 1; got {speed_tolerance!r}")
    speed = in_rad_s("speed", speed, needed=False, rpm=speed_rpm)
    if speed is not None and not np.isfinite(speed):
        raise ValueError(f"speed must be a finite number, rad/s; got {speed!r}")
    table = {"sheet": sheet, "columns": columns, "constants": constants}
    callbacks = {"on_lines": on_lines, "progress": progress}
    test = _read_raw(path, {"speed": speed, "axes": axes}, table, callbacks, speed_tolerance)
    if kind is not None and not isinstance(test, kind):
        raise ValueError(f"{test.source} holds a {test.title}, not a {kind.title} (kind={kind.__name__})")
    _check_sizes(test)
    whole = len(test)
    test = selected(test, where=where, exclude=exclude, drop_near_1x=drop_near_1x)
    left_out = whole - len(test)
    moved: dict[str, Any] = {"casing": casing, "stator": stator}
    corrections: dict[str, Any] = {
        "gains": gains,
        "delays": delays,
        "slow_roll": slow_roll,
        "slow_roll_below_rpm": slow_roll_below_rpm,
        "probe_angles": probe_angles,
    }
    if (responses := test.perturbation) is not None:
        test = responses = _corrected(responses, *corrections.values())
        if difference and test.synchronous:
            apart = difference_unless_solved(test)
            if apart is not test and (pairs := uneven_weights(test)):
                words = (
                    f"{test.source}: opposite weights differ: {listed(pairs)}. If it is one weight that was turned by "
                    "180 degrees, one of the two is wrong, and all masses, stiffnesses and dampings with it."
                )
                apart = replace(apart, findings=(*apart.findings, Finding("warning", "uneven-weights", words)))
            test = apart
        test = without_stator(with_casing(test, casing), stator)
    elif given := [name for name, value in {**corrections, **moved}.items() if value is not None]:
        raise ValueError(f"{', '.join(given)} correct probe readings; {test.source} is a {type(test).__name__}")
    warn_of(test.findings)
    found = without(test, skip)
    _LOG.info("read %r", found)
    if left_out := left_out + len(test) - len(found):
        _LOG.info("%s: %d of %d readings were not wanted", found.source, left_out, whole)
    return found


_FASTEST = 1e10
"""Speed and frequency, rad/s, beyond which there is none: as the largest sampling rate of a recording."""


def _check_sizes(test: Experiment) -> None:
    """Refuse numbers whose products are none any more; those that are only implausible are found by a check."""
    for name in test._columns():
        column = getattr(test, name)
        if name in ("speed", "frequency") and (rows := np.flatnonzero(np.abs(column) > _FASTEST)).size:
            raise ValueError(
                f"{test.source or 'the table'}: reading {rows[0] + 1}: {name} is {column[rows[0]]:.3g} rad/s; up to "
                f"{_FASTEST:g} are allowed: is its unit right?"
            )
        vanishing = name in ("force", "response", "sigma")
        small = (column != 0) & (np.abs(column) < 1 / LARGEST) if vanishing else np.zeros(0)
        if (rows := np.flatnonzero(small)).size:
            raise ValueError(
                f"{test.source or 'the table'}: reading {rows[0] + 1}: {name} is {abs(column[rows[0]]):.3g} in SI "
                f"units; other than zero it is at least {1 / LARGEST:g}"
            )
        for part in (column.real, column.imag) if column.dtype.kind in "fc" else ():
            if max(np.fmax.reduce(part, initial=0.0), -np.fmin.reduce(part, initial=0.0)) > LARGEST:
                row = int(np.flatnonzero(np.abs(part) > LARGEST)[0])
                raise ValueError(
                    f"{test.source or 'the table'}: reading {row + 1}: {name} is {part[row]:.3g} in SI units; numbers "
                    f"may be up to {LARGEST:g} in size"
                )


def _corrected(
    test: PerturbationTest, gains: Any, delays: Any, slow_roll: Any, below_rpm: float | None, angles: Any
) -> PerturbationTest:
    """Probe readings with their corrections, in the order of the arguments of :func:`read`."""
    if gains or delays:
        test = correct_channels(test, gains or {}, delays or {})
    if slow_roll is not None and below_rpm is not None:
        raise ValueError("slow_roll and slow_roll_below_rpm are both given; choose one")
    if slow_roll:
        check_channels(test, slow_roll, "slow_roll")
        if not all(np.isfinite(value) for value in slow_roll.values()):
            raise ValueError("slow_roll: a run-out vector must be finite, m (rad for slopes), complex")
        test = test.subtract_slow_roll(slow_roll)
    if below_rpm is not None:
        test = subtract_measured_slow_roll(test, below_rpm * RAD_S_PER_RPM)
    return resolve_probe_angles(test, angles) if angles else test


_FORMATS = {
    "csv": ("table", "tables.tidy_csv"),
    "uff": ("universal file", "universal"),
    "netcdf": ("netCDF file", "netcdf"),
    "mat": ("MAT file of version 5", "matlab"),
}
"""Name in messages and module by format; the module has ``read_<format>`` and ``write_<format>``."""


def _of_format(kind: str, does: str) -> Callable[..., Any]:
    """Reader or writer of a format, which is imported when it is needed."""
    found: Callable[..., Any] = getattr(import_module(f"rotorfit.lab.io.{_FORMATS[kind][1]}"), f"{does}_{kind}")
    return found


def _read_raw(
    path: str | Path | DataFrame,
    universal: Mapping[str, Any],
    table: Mapping[str, Any],
    callbacks: Mapping[str, Any],
    speed_tolerance: float,
) -> Experiment:
    """Read a file with the options of its format; those of another format are refused."""
    options = {**table, **callbacks, "speed_tolerance": speed_tolerance}
    if not isinstance(path, str | Path):
        in_memory: Experiment = _of_format("csv", "read")(path, **options)
        return in_memory
    kind = _format(path)
    note_input(Path(path))
    with reading(Path(path).name, _FORMATS[kind][0]):
        given = {**universal, "axes": universal["axes"] != "xy"}
        for of, files, own in (("uff", "universal files", given), ("csv", "tables (CSV and Excel)", table)):
            name = next((name for name, value in own.items() if value), None)
            if name and kind != of:
                raise ValueError(f"{name} is an option of {files}, which {Path(path).name} is not")
        test: Experiment = _of_format(kind, "read")(path, **{"csv": options, "uff": universal}.get(kind, {}))
        return test if kind == "csv" else replace(test, speed_tolerance=speed_tolerance)


def write(experiment: Experiment, path: str | Path) -> None:
    """Write an experiment; the suffix tells the format as in :func:`read`. A failure leaves an existing file as it was.

    Args:
        experiment: what to write.
        path: the file, replaced if it exists.

    Raises:
        ValueError: unknown suffix, an Excel file, which is read only, or something that the format cannot hold.
        FileNotFoundError: no such folder.

    Example:
        >>> rf.write(rig, folder / "rig.nc")
        >>> len(rf.read(folder / "rig.nc")) == len(rig)
        True
    """
    target = check_target(path)
    writer = _of_format(_format(target), "write")
    with whole_file(target) as draft:
        writer(experiment, draft)


def to_dataframe(experiment: Experiment) -> DataFrame:
    """An experiment as a table with the columns of a tidy CSV, which :func:`read` takes too.

    Args:
        experiment: what was measured.

    Example:
        >>> len(rf.to_dataframe(rig)) == len(rig)
        True
    """
    from pandas import DataFrame

    from rotorfit.lab.io.tables.tidy_csv import written_columns

    return DataFrame(written_columns(experiment))


def check_target(path: str | Path) -> Path:
    """Refuse, before any work, a file that could not be written."""
    target = Path(path)
    _format(target)
    if target.suffix.lower() in READ_ONLY:
        kind = "Excel files are" if target.suffix.lower() in EXCEL else "JSON of records is"
        raise ValueError(f"{target.name}: {kind} read, not written; write .csv, which Excel opens")
    if not target.parent.is_dir():
        raise FileNotFoundError(f"cannot write {target}: there is no folder {target.parent}")
    refuse_input(target)
    return target


def _format(path: str | Path) -> str:
    suffix = Path(path).suffix.lower()
    if suffix in RECORDINGS:
        name = Path(path).name
        raise ValueError(
            f"{name} is a recording of raw signals, not of vectors: read it with a setup of the rig "
            f"(rf.read_recording, --setup rig.toml); `rotorfit template {name}` makes one to fill in"
        )
    if suffix in READ_ONLY:
        return "csv"
    allowed = (*SUFFIXES, *READ_ONLY)
    if suffix not in SUFFIXES and Path(path).is_dir():
        raise ValueError(f"{path} is a folder; name a file in it, with one of the suffixes {', '.join(allowed)}")
    if suffix not in SUFFIXES:
        raise ValueError(f"{Path(path).name}: {unread_suffix('suffix', suffix, [*allowed])}")
    return SUFFIXES[suffix]
