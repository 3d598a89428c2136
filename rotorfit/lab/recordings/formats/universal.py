"""Universal files with time records: functions at nodal DOF (dataset 58), by pyuff.

They are of type 1, or, as some makers write them, of no type (0) over an abscissa that is time.

A channel is called by the entity or node and the direction of its response, ``disk_X``, else by its first ID line.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.lab.io.sampling import FEWEST, rate_of_times
from rotorfit.lab.recordings.formats.raw_file import RawChannel, RawFile, once, spooled

_AXES = {1: "X", 2: "Y", 3: "Z", -1: "-X", -2: "-Y", -3: "-Z"}


def open_file(path: Path) -> RawFile:
    """The time records of a universal file; each is read when it is first asked for."""
    import pyuff

    marks = re.findall(rb"(?m)^    -1 *\r?$", path.read_bytes())
    if len(marks) % 2:
        raise ValueError(f"{path.name} is not a whole universal file: its last data set has no end; copy it again")
    file = pyuff.UFF(str(path))
    numbers = [i for i, kind in enumerate(file.get_set_types()) if kind == 58]
    records = {i: file.read_sets(i, header_only=True) for i in numbers}
    channels: dict[str, RawChannel] = {}
    general, time_response = 0, 1  # types of functions
    of_times = 17  # data type of an abscissa that is time
    for i, record in records.items():
        of_time = record["func_type"] == general and record.get("abscissa_spec_data_type") == of_times
        real = record["ord_data_type"] in (2, 4)
        if not (record["func_type"] == time_response or (of_time and real)) or record["num_pts"] < FEWEST:
            continue
        words = [str(record.get(key) or "").strip() for key in ("rsp_ent_name", "id1")]
        entity, title = ("" if word.upper() in ("NONE", "") else word for word in words)
        axis = _AXES.get(int(record["rsp_dir"]))
        place = entity or (str(record["rsp_node"]) if record["rsp_node"] else "")
        name = f"{place}_{axis}" if axis and place else title or place or "signal"
        name = name if name not in channels else f"{name} ({i + 1})"
        channels[name] = RawChannel(
            name=name,
            size=int(record["num_pts"]),
            samples=once(partial(_load, path, i)),
            sample_rate=_rate(path, i, record),
            unit=str(record.get("ordinate_axis_units_lab") or "").strip(),
        )
    return RawFile(name=path.name, channels=channels)


def _rate(path: Path, number: int, record: dict[str, Any]) -> float | None:
    if record["abscissa_spacing"] == 1:
        return 1 / float(record["abscissa_inc"]) if record["abscissa_inc"] > 0 else None
    return rate_of_times(_load(path, number, "x"), f"{path.name}, record {number + 1}")


def _load(path: Path, number: int, part: str = "data") -> NDArray[Any]:
    import pyuff

    values = np.asarray(pyuff.UFF(str(path)).read_sets(number)[part], dtype=float)
    return spooled([values], values.size, np.float64)
