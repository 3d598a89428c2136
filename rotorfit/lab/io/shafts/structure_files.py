"""Matrices of a shaft from a file: MAT, npz, a folder of CSV tables, or a saved rotor of the ROSS package."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.atomic_file import note_input
from rotorfit.base.file_reading import check_archive, check_unpacked, reading
from rotorfit.estimators.misfit.parameter_space import LARGEST
from rotorfit.lab.io.matlab import mat_content
from rotorfit.models.shafts.shaft import DOFS, MATRICES, ROSS_4, ROSS_6

SAVED_ROTORS = (".toml", ".json")
"""Suffixes of rotors that the ROSS package saved."""

_DOFS_BY_COUNT = {1: ("z",), 2: ("z", "r"), 4: ROSS_4, 6: ROSS_6}
"""Coordinates of a node by how many it has."""
_POSITIONS = ("nodes", "nodes_pos")
"""Names of the nodes' positions: ROSS's in a file, and that of its attribute."""


def read_structure(path: Path, dofs: Sequence[str] = ()) -> dict[str, Any]:
    """Matrices M, C, G, K, as far as they are given, from a MAT or npz file, or a folder of M.csv, K.csv and so on.

    The coordinates of a node in their order are ``dofs``, else those of the file, else they follow from ``nodes``, the
    positions of the nodes along the shaft, m, which ROSS's ``rotor.save_mat`` writes.
    """
    source = path.name
    if path.is_dir():
        content = _from_folder(path)
    elif path.suffix.lower() == ".npz":
        content = _from_npz(path)
    elif path.suffix.lower() == ".mat":
        content = mat_content(path)
    else:
        raise ValueError(
            f"{source}: matrices of a shaft come as .mat, .npz, a folder with M.csv, K.csv, C.csv and G.csv, or as a "
            f"rotor saved by ROSS ({', '.join(SAVED_ROTORS)})"
        )
    matrices: dict[str, Any] = {}
    for name in (name for name in MATRICES if name in content):
        values = content[name]
        if values.dtype.kind not in "iufc" or values.ndim != 2:
            raise ValueError(f"{source}: {name} is not a matrix of numbers but {values.dtype} of shape {values.shape}")
        if (largest := float(np.abs(values).max(initial=0.0))) > LARGEST:
            raise ValueError(
                f"{source}: {name} has an entry of {largest:.3g}; numbers may be up to {LARGEST:g} in size"
            )
        matrices[name] = values.astype(complex if values.dtype.kind == "c" else float)
    missing = [name for name in ("M", "K") if name not in matrices]
    if missing:
        there = ", ".join(sorted(content)) or "nothing"
        raise ValueError(
            f"{source} has no {' and no '.join(missing)}: the matrices of a shaft are called M, K and, where there are "
            f"any, C and G (so ROSS's rotor.save_mat writes them); it holds {there}"
        )
    shapes = {matrix.shape for matrix in matrices.values()}
    if len(shapes) > 1 or len({size for shape in shapes for size in shape}) > 1:
        sizes = ", ".join(f"{name} {matrix.shape[0]} x {matrix.shape[1]}" for name, matrix in matrices.items())
        raise ValueError(f"{source}: matrices of a shaft are square and of one size; here are {sizes}")
    return {**matrices, "dofs": tuple(dofs) or _dofs(content, len(matrices["K"]), source)}


def _dofs(content: Mapping[str, NDArray[Any]], size: int, source: str) -> tuple[str, ...]:
    if "dofs" in content:
        return tuple(str(np.asarray(name).reshape(-1)[0]).strip() for name in content["dofs"].reshape(-1))
    name = next((name for name in _POSITIONS if name in content), None)
    if name is None:
        raise ValueError(
            f"{source} does not say what the {size} coordinates are: give the positions of the nodes as nodes, or the "
            f"coordinates of a node as dofs, for instance {','.join(ROSS_4)} (of {', '.join(DOFS)})"
        )
    positions = content[name].reshape(-1)
    nodes, longest = positions.size, 100.0  # m, a ship's shaft line
    if positions.dtype.kind not in "iuf":
        raise ValueError(f"{source}: the positions of the nodes are not numbers but {positions.dtype}")
    # matrices in other units are wrong by powers of ten, and look like any
    if not np.isfinite(positions).all() or np.ptp(positions.astype(float)) > longest:
        raise ValueError(
            f"{source}: the nodes stand from {positions.min():g} to {positions.max():g}, which are no metres; matrices "
            "and positions must be in SI units: m, kg, N"
        )
    count, rest = divmod(size, nodes)
    if rest or count not in _DOFS_BY_COUNT:
        supports, odd = divmod(size - 6 * nodes, 3)
        stands = (
            f": the {size - 6 * nodes} beyond 6 a node are those of {supports} support masses (n_link), which a known "
            "structure does not have. Link the bearings to the ground, or take them out and fit them"
            if supports > 0 and not odd
            else f"; {', '.join(map(str, _DOFS_BY_COUNT))} a node are read. Give the coordinates of a node as dofs"
        )
        raise ValueError(f"{source} has {nodes} nodes and matrices of {size} coordinates{stands}")
    return _DOFS_BY_COUNT[count]


# ---- formats -----------------------------------------------------------------------------------


def _from_npz(path: Path) -> dict[str, NDArray[Any]]:
    path.open("rb").close()
    with reading(path.name, "npz file"):
        if not zipfile.is_zipfile(path):
            raise ValueError("it is not an archive")
        check_archive(path)
        with np.load(path, allow_pickle=False) as content:
            return {name: np.asarray(content[name]) for name in content.files}


def _from_folder(path: Path) -> dict[str, NDArray[Any]]:
    """Tables of numbers, one a file, named by the matrix."""
    found = {file.stem: file for file in sorted(path.iterdir()) if file.suffix.lower() in (".csv", ".txt")}
    content: dict[str, NDArray[Any]] = {}
    for name, file in found.items():
        if name not in (*MATRICES, *_POSITIONS, "dofs"):
            continue
        note_input(file)
        with reading(file.name, "table of numbers"):
            text = file.read_text(encoding="utf-8-sig")
            check_unpacked(file.name, 16.0 * len(text), len(text))
            rows = [line.replace(";", ",").replace("\t", ",") for line in text.splitlines() if line.strip()]
            cells = [[cell.strip() for cell in (row.split(",") if "," in row else row.split())] for row in rows]
            lengths = {len(row) for row in cells}
            if len(lengths) > 1:
                raise ValueError(f"{file.name}: rows have {' and '.join(map(str, sorted(lengths)))} numbers")
            content[name] = np.array(cells, dtype=str if name == "dofs" else float)
    return content
