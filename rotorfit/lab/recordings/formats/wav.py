"""WAV recordings: channels ``channel_1``, ``channel_2``, ... of counts; ``[[channel]]`` of the setup scales them."""

from __future__ import annotations

import wave
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.lab.recordings.formats.raw_file import RawArray, RawChannel, RawFile


def open_file(path: Path) -> RawFile:
    """Content of a WAV file: integer samples of 16, 24 or 32 bits, or floating-point ones, which are volts."""
    try:  # by the standard library, which seeks and so reads pieces of 24-bit files too
        with wave.open(str(path), "rb") as file:
            rate, count, width, size = file.getframerate(), file.getnchannels(), file.getsampwidth(), file.getnframes()
    except (wave.Error, EOFError) as problem:
        return _floating(path, problem)
    if width == 1:
        raise ValueError(f"{path.name} has samples of 8 bits, too coarse for vibration; export 16 or 24 bits")
    if path.stat().st_size < size * count * width:
        raise ValueError(f"{path.name} is not a whole WAV file: it ends before its {size} samples a channel")
    channels = {}
    for i in range(count):
        name, read = f"channel_{i + 1}", partial(_read, path, i, count, width)
        channels[name] = RawChannel(name=name, size=size, samples=read, full_count=2.0 ** (8 * width - 1) - 1)
    return RawFile(name=path.name, channels=channels, sample_rate=float(rate))


def _read(path: Path, column: int, count: int, width: int, start: int, stop: int) -> NDArray[Any]:
    with wave.open(str(path), "rb") as file:
        file.setpos(min(start, file.getnframes()))
        raw = np.frombuffer(file.readframes(max(stop - start, 0)), dtype=np.uint8).reshape(-1, count, width)[:, column]
    padded = np.zeros((raw.shape[0], 4), dtype=np.uint8)
    padded[:, 4 - width :] = raw  # the top bytes of a 32-bit number, so that the sign comes out
    return padded.reshape(-1).view("<i4") >> (8 * (4 - width))


def _floating(path: Path, problem: Exception) -> RawFile:
    """Floating-point samples, by SciPy's memory map."""
    from scipy.io import wavfile

    try:
        rate, data = wavfile.read(path, mmap=True)
    except ValueError:
        why = f": {problem}" if str(problem) else ""
        raise ValueError(f"{path.name} is not a readable WAV file{why}") from problem
    if data.dtype.kind != "f":
        raise ValueError(f"{path.name} has samples of type {data.dtype}; export 16 or 24 bits")
    columns = data.reshape(data.shape[0], -1).T
    channels = [c for i, column in enumerate(columns, 1) for c in RawArray.of(column).channels([f"channel_{i}"])]
    return RawFile(name=path.name, channels={c.name: c for c in channels}, sample_rate=float(rate))
