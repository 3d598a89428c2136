"""NumPy recordings (.npz): a vector a channel, or a matrix with a list of names; ``fs`` or a vector ``t``; attributes.

Attributes of the rig are numbers and text, or one text of JSON. Pickled Python objects are not opened: they can run
anything.
"""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from rotorfit.base.file_reading import check_archive
from rotorfit.lab.recordings.formats.matlab import file_of, held
from rotorfit.lab.recordings.formats.raw_file import RawFile


def open_file(path: Path) -> RawFile:
    """Content of an npz file."""
    if not zipfile.is_zipfile(path):
        raise ValueError(f"{path.name} is not a readable npz file: NumPy's savez writes one")
    check_archive(path)
    tree: dict[str, Any] = {}
    with np.load(path, allow_pickle=False) as content:
        for name in content.files:
            try:
                values = content[name]
            except ValueError as problem:
                raise ValueError(
                    f"{path.name}: {name} is a pickled Python object, which is not opened; save its entries as arrays "
                    f"of their own, or as text: {name}=json.dumps(...)"
                ) from problem
            if not isinstance(values, np.ndarray):
                raise ValueError(f"{path.name}: {name} is no array; NumPy's savez writes them")
            value = held(values[()] if values.ndim == 0 else values)
            try:
                said = json.loads(value) if isinstance(value, str) else None
            except json.JSONDecodeError:
                said = None
            tree |= said if isinstance(said, dict) else {name: value}
    return file_of(path.name, tree)
