"""TDMS recordings of LabVIEW and its data loggers, by npTDMS (``pip install rotorfit[tdms]``)."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.lab.io.sampling import FEWEST, rate_of
from rotorfit.lab.recordings.formats.raw_file import RawChannel, RawFile, full_count, plain, unit_said


def open_file(path: Path) -> RawFile:
    """Content of a TDMS file; scaled channels are in volts, others in counts."""
    with _opened(path) as file:
        attributes, whole = plain(file.properties), not file.file_status.incomplete_final_segment
        found = [channel for group in file.groups() for channel in group.channels() if len(channel) >= FEWEST]
        names = [channel.name for channel in found]
        channels: dict[str, RawChannel] = {}
        for channel in found:
            name = channel.name if names.count(channel.name) == 1 else f"{channel.group_name}/{channel.name}"
            kind = np.dtype(channel.dtype)
            if kind.kind in "iuf":
                said = plain(channel.properties)
                channels[name] = RawChannel(
                    name=name,
                    size=len(channel),
                    samples=partial(_read, path, channel.group_name, channel.name),
                    full_count=full_count(kind),
                    sample_rate=rate_of(said),
                    unit=unit_said(said),
                )
    if not whole:
        raise ValueError(f"{path.name} is not a whole TDMS file: its last segment is cut off; copy it again")
    return RawFile(name=path.name, channels=channels, attributes=attributes, sample_rate=rate_of(attributes))


def _read(path: Path, group: str, name: str, start: int, stop: int) -> NDArray[Any]:
    with _opened(path) as file:
        return np.asarray(file[group][name][start:stop])


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """The file by npTDMS. It logs, and gives counts for volts, where it does not know a scale: that is refused."""
    try:
        from nptdms import TdmsFile
        from nptdms.log import log_manager
    except ImportError as problem:
        raise ValueError(f"{path.name}: TDMS needs npTDMS; pip install 'rotorfit[tdms]'") from problem
    logged: list[logging.LogRecord] = []
    keep = logged.append  # which returns None: nothing is printed
    log_manager.console_handler.addFilter(keep)
    try:
        with TdmsFile.open(path) as file:
            yield file
    finally:
        log_manager.console_handler.removeFilter(keep)
    for record in logged:
        if record.name == "nptdms.scaling":
            raise ValueError(f"{path.name}: {record.getMessage()}; the values would stay counts")
