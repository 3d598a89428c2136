"""MATLAB files of version 5: one variable a column, SI units, complex as complex, text as cell arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.experiments import Experiment
from rotorfit.io.columns import build, column_types


def write_mat(experiment: Experiment, path: str | Path) -> None:
    """Write an experiment as MAT 5, exact to the last bit.

    In MATLAB, ``load`` gives ``speed``, ``frequency`` (rad/s), ``force`` (N), ``response`` (m), cell arrays ``run``,
    ``plane`` ...; ``kind`` names the experiment, ``attribute_names{k}`` belongs to ``attribute_k``.
    """
    from scipy.io import savemat

    names = list(experiment.attributes)
    variables: dict[str, Any] = {
        "kind": type(experiment).__name__,
        "attribute_names": np.array(names, dtype=object),
    }
    for name in column_types(type(experiment)):
        variables[name] = _stored(getattr(experiment, name))
    for number, name in enumerate(names, 1):
        variables[f"attribute_{number}"] = _stored(experiment.attributes[name])
    savemat(path, variables, appendmat=False, oned_as="column", do_compression=True)


def read_mat(path: str | Path) -> Experiment:
    """Read an experiment written by :func:`write_mat`, or by MATLAB with the same variables.

    Raises:
        ValueError: not a MAT file of version 5, or one without the variables of an experiment.
        FileNotFoundError: no such file.
    """
    from scipy.io import loadmat

    Path(path).open("rb").close()  # a missing file or a folder is reported by its own exception
    source = Path(path).name
    try:
        content = loadmat(path, appendmat=False)
    except NotImplementedError as error:
        raise ValueError(f"{source} is a MAT file of version 7.3; save it with save(name, ..., '-v7')") from error
    except Exception as error:  # whatever the parser raises on a damaged file
        raise ValueError(f"{source} is not a readable MAT file (version 5): {error}") from error
    columns = {name: _column(values) for name, values in content.items() if not name.startswith("__")}
    names = columns.pop("attribute_names", np.array([], dtype=str)).tolist()
    numbered = [f"attribute_{number}" for number in range(1, len(names) + 1)]
    lost = [name for name in numbered if name not in columns]
    if lost:
        raise ValueError(f"{source}: attribute_names lists {len(names)} names, but {', '.join(lost)} is missing")
    attributes = {name: columns.pop(stored) for name, stored in zip(names, numbered, strict=True)}
    kind = columns.pop("kind", np.array(["PerturbationTest"]))
    return build(str(kind[0]) if kind.size else "", columns, attributes, source)


def _stored(values: NDArray[Any]) -> NDArray[Any]:
    return values.astype(object) if values.dtype.kind == "U" else values


def _column(values: Any) -> NDArray[Any]:
    """A MATLAB row or column as a flat array; cells of text, and rows of a character matrix, as text."""
    flat = np.atleast_1d(np.asarray(values)).reshape(-1)
    if flat.dtype.kind == "O":
        flat = np.array(["".join(np.asarray(cell).astype(str).reshape(-1)) for cell in flat.tolist()], dtype=str)
    elif flat.dtype.kind == "U":
        flat = np.char.rstrip(flat)  # rows of a character matrix are filled up with blanks
    return flat
