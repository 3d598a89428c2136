"""MATLAB files of version 5: one variable a column, SI units, complex as complex, text as cell arrays.

Read are also variables with the names of the tidy CSV (``speed_rpm``, ``amplitude_um`` ..., whose end is the unit); a
struct whose fields are such variables, of either naming; and a struct array, or a cell array of structs, whose elements
are rows or runs: their fields are put one after the other, single values standing for all rows of their element.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.file_reading import check_mat, check_unpacked, reading
from rotorfit.estimators.blocks.set_speeds import SPEED_TOLERANCE
from rotorfit.lab.data.rows import Experiment
from rotorfit.lab.io.columns import build, column_types, shown_words
from rotorfit.lab.io.tables.cells import Numbers
from rotorfit.lab.io.tables.table import Table
from rotorfit.lab.io.tables.tidy_csv import experiment_of


def write_mat(experiment: Experiment, path: str | Path) -> None:
    """Write an experiment as MAT 5, exact to the last bit.

    In MATLAB, ``load`` gives ``speed``, ``frequency`` (rad/s), ``force`` (N), ``response`` (m), cell arrays ``run``,
    ``plane`` ...; ``kind`` names the experiment, ``attribute_names{k}`` belongs to ``attribute_k``.
    """
    from scipy.io import savemat

    experiment = experiment.stored_rows()
    names = list(experiment.attributes)
    variables: dict[str, Any] = {"kind": type(experiment).__name__, "attribute_names": np.array(names, dtype=object)}
    for name in column_types(experiment):
        variables[name] = _stored(getattr(experiment, name))
    for number, name in enumerate(names, 1):
        variables[f"attribute_{number}"] = _stored(experiment.attributes[name])
    savemat(path, variables, appendmat=False, oned_as="column", do_compression=True)


def mat_content(path: Path) -> dict[str, Any]:
    """Variables of a MAT file of version 5, sparse matrices whole."""
    from scipy.io import loadmat

    path.open("rb").close()  # a missing file or a folder is reported by its own exception
    with reading(path.name, "MAT file of version 5"):
        check_mat(path)
        try:
            content = loadmat(path, appendmat=False)
        except NotImplementedError as error:
            advice = "save it with save(name, ..., '-v7')"
            raise ValueError(f"{path.name} is a MAT file of version 7.3; {advice}") from error
        variables = {name: values for name, values in content.items() if not name.startswith("__")}
        sparse = [name for name, values in variables.items() if hasattr(values, "toarray")]
        declared = sum(8.0 * variables[name].shape[0] * variables[name].shape[1] for name in sparse)
        check_unpacked(path.name, declared, path.stat().st_size)
        return variables | {name: variables[name].toarray() for name in sparse}


def read_mat(path: str | Path) -> Experiment:
    """Read an experiment written by :func:`write_mat`, or by MATLAB with the variables that the module names."""
    source = Path(path).name
    columns = _columns(mat_content(Path(path)), source)
    if "speed" not in columns and any(name.lower().startswith("speed_") for name in columns):
        return experiment_of(_table(columns, source), SPEED_TOLERANCE)
    _refuse_bare_responses(columns, source)
    names = columns.pop("attribute_names", np.array([], dtype=str)).tolist()
    numbered = [f"attribute_{number}" for number in range(1, len(names) + 1)]
    lost = [name for name in numbered if name not in columns]
    if lost:
        raise ValueError(f"{source}: attribute_names lists {len(names)} names, but {', '.join(lost)} is missing")
    attributes = {name: columns.pop(stored) for name, stored in zip(names, numbered, strict=True)}
    kind = columns.pop("kind", np.array(["PerturbationTest"]))
    return build(str(kind[0]) if kind.size else "", columns, attributes, source)


def refuse_bare_responses(path: Path) -> None:
    """Refuse a file of frequencies and complex responses alone, for those who take it for a recording."""
    _refuse_bare_responses(_columns(mat_content(path), path.name), path.name)


def _refuse_bare_responses(columns: Mapping[str, NDArray[Any]], source: str) -> None:
    """Refuse frequencies and complex responses alone, as analysers export f and H, with what makes a test of them."""
    if {"response", "frequency", "kind"} & columns.keys():
        return
    complex_ones = [name for name, values in columns.items() if values.dtype.kind == "c"]
    lengths = {name: values.size for name, values in columns.items() if values.dtype.kind in "fiu" and values.size > 1}
    pairs = [(f, h) for h in complex_ones for f, size in lengths.items() if columns[h].size % size == 0]
    if pairs:
        f, h = pairs[0]
        raise ValueError(
            f"{source} holds frequencies ({f}) and responses ({h}), but not where, by what and in which unit they were "
            f"measured. Save beside them, of each response, frequency_hz = {f}; real_um = real({h}) * 1e6 (of m/N); "
            f"imag_um = imag({h}) * 1e6; force_N = 1; force_phase_deg = 0; force_direction, plane, direction, "
            "force_plane (text) and speed_rpm; or export a universal file"
        )


def _columns(content: Mapping[str, Any], source: str) -> dict[str, NDArray[Any]]:
    """Variables of a file, or the fields of its struct, as flat arrays."""
    structs = {name: elements for name, values in content.items() if (elements := _elements(values))}
    if not structs:
        return {name: _column(values) for name, values in content.items()}
    if len(structs) > 1:
        raise ValueError(f"{source} has several structs, {', '.join(structs)}; save the one of the test alone")
    name, elements = next(iter(structs.items()))
    parts = []
    for number, element in enumerate(elements, 1):
        where = f"{source}: struct {name}{f'({number})' if len(elements) > 1 else ''}"
        parts.append(_fields(element, where))
        if list(parts[-1]) != list(parts[0]):
            raise ValueError(f"{where} has the fields {', '.join(parts[-1])}, the first has {', '.join(parts[0])}")
    if len(parts) == 1:
        return parts[0]
    return {field: np.concatenate([part[field] for part in parts]) for field in parts[0]}


def _elements(values: Any) -> list[Any]:
    """Elements of a struct array or of a cell array of structs; none if it is neither."""
    array = np.asarray(values)
    if array.dtype.names:
        return list(array.reshape(-1))
    cells = array.reshape(-1).tolist() if array.dtype.kind == "O" else []
    inner = [_elements(cell) if isinstance(cell, np.ndarray) else [] for cell in cells]
    return [element for elements in inner for element in elements] if inner and all(inner) else []


def _fields(element: Any, where: str) -> dict[str, NDArray[Any]]:
    """Fields of one element, single values and one word spread over its rows."""
    fields = {}
    for name in element.dtype.names:
        if _elements(element[name]):
            raise ValueError(f"{where}: field {name} is a struct itself; save it as fields of one struct")
        fields[name] = _column(element[name])
    rows = max(values.size for values in fields.values())
    uneven = {name: values.size for name, values in fields.items() if values.size not in (1, rows)}
    if uneven:
        raise ValueError(f"{where}: fields have 1 or {rows} values, but {', '.join(uneven)} {list(uneven.values())}")
    return {name: np.repeat(values, rows) if values.size == 1 else values for name, values in fields.items()}


def _table(columns: Mapping[str, NDArray[Any]], source: str) -> Table:
    """Columns named as in a tidy CSV as its table, to the last bit."""
    kept = {name: values for name, values in columns.items() if name not in ("kind", "attribute_names")}
    rows = max(values.size for values in kept.values())
    cells: dict[str, Sequence[str]] = {}
    for name, values in kept.items():
        if values.dtype.kind == "c":
            raise ValueError(f"{source}: {name} is complex; give real_um and imag_um, or amplitude and phase")
        if values.size not in (1, rows):
            raise ValueError(f"{source}: {name} has {values.size} values, other columns have {rows}")
        spread = np.repeat(values, rows) if values.size == 1 else values
        cells[name.lower()] = spread.tolist() if values.dtype.kind == "U" else Numbers(spread.astype(float))
    return Table(source=source, cells=cells, lines=np.arange(1, rows + 1), names={name.lower(): name for name in kept})


def _stored(values: NDArray[Any]) -> NDArray[Any]:
    return values.astype(object) if values.dtype.kind == "U" else values


def _column(values: Any) -> NDArray[Any]:
    """A MATLAB row or column as a flat array; cells of text, and rows of a character matrix, as text."""
    flat = np.atleast_1d(np.asarray(values)).reshape(-1)
    if flat.dtype.kind == "O":
        flat = np.array(["".join(np.asarray(cell).astype(str).reshape(-1)) for cell in flat.tolist()], dtype=str)
    elif flat.dtype.kind == "U":
        flat = np.char.rstrip(flat)  # rows of a character matrix are filled up with blanks
    return shown_words(flat)
