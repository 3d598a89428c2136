"""Universal files with time records: functions at nodal DOF (dataset 58), by pyuff.

They are of type 1, or, as some makers write them, of no type (0) over an abscissa that is time.

A channel is called by the entity or node and the direction of its response, ``disk_X``, else by its first ID line.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.lab.io.sampling import FEWEST, rate_of_times
from rotorfit.lab.io.universal_file import universal_records
from rotorfit.lab.recordings.formats.raw_file import RawChannel, RawFile, once, spooled

_AXES = {1: "X", 2: "Y", 3: "Z", -1: "-X", -2: "-Y", -3: "-Z"}


def open_file(path: Path) -> RawFile:
    """The time records of a universal file; each is read when it is first asked for."""
    records = universal_records(path, header_only=True)
    channels: dict[str, RawChannel] = {}
    remarks: list[str] = []
    general, time_response = 0, 1  # types of functions
    of_times = 17  # data type of an abscissa that is time
    for i, record in enumerate(records):
        if record.get("type") != 58:
            continue
        of_time = record["func_type"] == general and record.get("abscissa_spec_data_type") == of_times
        real = record["ord_data_type"] in (2, 4)
        if not (record["func_type"] == time_response or (of_time and real)) or record["num_pts"] < FEWEST:
            continue
        words = [str(record.get(key) or "").strip() for key in ("rsp_ent_name", "id1")]
        entity, title = ("" if word.upper() in ("NONE", "") else word for word in words)
        axis = _AXES.get(int(record["rsp_dir"]))
        place = entity or (str(record["rsp_node"]) if record["rsp_node"] else "")
        name = f"{place}_{axis}" if axis and place else title or place or "signal"
        samples = once(partial(_load, path, i))
        if name in channels:
            first, size = channels[name], int(record["num_pts"])
            if first.size == size and np.array_equal(first.samples(0, size), samples(0, size)):
                remarks.append(f"{path.name}: data set {i + 1} is {name} again, to the last digit, and was left out")
                continue
            name = f"{name} ({i + 1})"
        channels[name] = RawChannel(
            name=name,
            size=int(record["num_pts"]),
            samples=samples,
            sample_rate=_rate(path, i, record),
            unit=str(record.get("ordinate_axis_units_lab") or "").strip(),
        )
    return RawFile(name=path.name, channels=channels, remarks=tuple(remarks))


def _rate(path: Path, number: int, record: dict[str, Any]) -> float | None:
    if record["abscissa_spacing"] == 1:
        return 1 / float(record["abscissa_inc"]) if record["abscissa_inc"] > 0 else None
    return rate_of_times(_load(path, number, "x"), f"{path.name}, record {number + 1}")


def _load(path: Path, number: int, part: str = "data") -> NDArray[Any]:
    (record,) = universal_records(path, only=number)
    values = np.asarray(record[part], dtype=float)
    return spooled([values], values.size, np.float64)
