"""How files say their sampling rate: by one of its usual names, by a step, or by a column of times."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from rotorfit.base.array_types import Float

FEWEST = 64
"""Samples below which an array is a table or a setting, not a signal."""
_RATES = {
    "samplerate", "sampleratehz", "samplingrate", "samplingratehz", "samplefrequency", "samplingfrequency",
    "samplefreq", "samplingfreq", "fs", "fshz",
}  # fmt: skip
_STEPS = {
    "dt", "dts", "wfincrement", "xincrement", "increment", "xinc", "sampleinterval", "sampleintervals", "tsample",
    "deltat", "timestep", "xdelta",
}  # fmt: skip
_TIME = re.compile(
    r"(?i)^(?:t|time|times|timestamp|abscissa|elapsed(?:[ _]*time)?|zeit)"
    r"(?:[ _,]*[\[(]?(s|sec|seconds|ms|msec|us|µs)[\])]?)?$"
)
_SECONDS = {"s": 1.0, "sec": 1.0, "seconds": 1.0, "ms": 1e-3, "msec": 1e-3, "us": 1e-6, "µs": 1e-6}


_MONTH = r"(?:\d{1,2}|[A-Za-z]{3,9})"
_STAMP = re.compile(
    rf"(?:\d{{4}}[-/.]{_MONTH}[-/.](\d{{1,2}})[T ]+|(\d{{1,2}})[-/. ]{_MONTH}[-/. ](?:\d{{4}}|\d{{2}})[T ,]+)?"
    r"(\d{1,2}):(\d{2}):(\d{2}(?:[.,:]\d+)?)(?: ?([AaPp])\.?[Mm]\.?)?(?: ?Z| ?[+-]\d{2}:?\d{2})?"
)
"""Time of day, perhaps behind a date."""
_WITHOUT_SIGNS = re.compile(r"(\d{4})(\d{2})(\d{2})T(\d{2})(\d{2})(\d{2})")
"""A date and time of ISO 8601 in its basic form."""


def _stamp(cell: str) -> re.Match[str] | None:
    return _STAMP.fullmatch(_WITHOUT_SIGNS.sub(r"\1-\2-\3T\4:\5:\6", cell.strip().strip('"'), count=1))


def is_stamp(cell: str) -> bool:
    """True for a time of day, with or without a date."""
    return _stamp(cell) is not None


def seconds_of(cell: str) -> float:
    """Time of a stamp, s, from a day that all days of a recording are counted from. Whether day or month comes first in
    a date does not matter, unless a recording goes through midnight."""
    match = _stamp(cell)
    if match is None:
        raise ValueError(f"{cell[:40]!r} is no time of day")
    hours, minutes = float(match[3]), float(match[4])
    if match[6]:
        hours = hours % 12 + 12 * (match[6] in "Pp")
    seconds = float(re.sub("[,:]", ".", match[5]))
    return float(match[1] or match[2] or 0) * 86400 + hours * 3600 + minutes * 60 + seconds


def rate_of(said: Mapping[str, Any]) -> float | None:
    """Sampling rate, Hz, that attributes or fields give under one of its usual names; None without."""
    for names, power in ((_RATES, 1), (_STEPS, -1)):
        for name, value in said.items():
            if re.sub(r"[_\- ()\[\]]", "", name).lower() in names and isinstance(value, int | float) and value > 0:
                return float(value) ** power
    return None


def time_factor(name: str) -> float | None:
    """Seconds in the unit of a column that by its name holds times; None for any other column."""
    match = _TIME.match(name.strip())
    return None if match is None else _SECONDS[match[1].lower() if match[1] else "s"]


_DAYS = (20e3, 80e3), (700e3, 800e3)
"""Days of our time as spreadsheets and MATLAB count them, by which some export times."""


def rate_of_times(times: Float, where: str) -> float:
    """Sampling rate, Hz, of evenly spaced times in s."""
    if not np.isfinite(times).all():
        raise ValueError(f"{where}: a time is not a number at sample {int(np.flatnonzero(~np.isfinite(times))[0]) + 1}")
    if times.size < 2:
        raise ValueError(f"{where}: {times.size} times tell no sampling rate")
    steps = np.diff(times)
    step = float(times[-1] - times[0]) / steps.size
    if not step > 0:
        raise ValueError(f"{where}: the times do not increase")
    if any(low < times[0] < high for low, high in _DAYS) and step < 1e-6:
        times, steps, step = times * 86400.0, steps * 86400.0, step * 86400.0
    if not steps.all():
        raise ValueError(
            f"{where}: the times are rounded, several samples have the same; export them with more digits, or leave "
            "the column out and say sample_rate_hz"
        )
    odd = np.flatnonzero(np.abs(steps - np.median(steps)) > 0.5 * step)
    if odd.size:
        raise ValueError(
            f"{where}: the samples are not evenly spaced: {np.median(steps):.6g} s from one to the next, but "
            f"{steps[odd[0]]:.6g} s after sample {odd[0] + 1}; export the recording without gaps"
        )
    return 1 / step
