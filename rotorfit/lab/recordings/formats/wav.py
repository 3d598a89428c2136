"""WAV recordings: channels ``channel_1``, ``channel_2``, ... of counts; ``[[channel]]`` of the setup scales them.

The header is read here: Python's module ``wave`` takes the extensible one, which all writers of 24 bits or of more than
two channels write, from version 3.12 on only, and SciPy maps no samples of 24 bits. Files beyond 4 GB (RF64, BW64) are
read too.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from itertools import islice
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from rotorfit.lab.io.sampling import FEWEST
from rotorfit.lab.recordings.formats.raw_file import RawChannel, RawFile

_PCM, _FLOAT, _EXTENSIBLE = 1, 3, 0xFFFE
"""Formats of samples."""
_WIDTHS = {_PCM: (2, 3, 4), _FLOAT: (4, 8)}
"""Bytes of a sample by format."""
_OTHERS = {b"FORM": "AIFF", b"fLaC": "FLAC", b"OggS": "Ogg", b"RIFX": "WAV of big-endian numbers", b"ID3": "MP3"}
"""What other sound files begin with."""
_MOST = 4096
"""Parts of a file in which its samples are looked for."""
_EXPORT = "export 16 or 24 bits, PCM, or floating-point numbers"


@dataclass(frozen=True, kw_only=True)
class _Samples:
    """Where the samples of a file are, and what they are."""

    floating: bool  # else whole numbers
    count: int  # channels
    rate: int  # Hz
    width: int  # bytes of a sample
    begin: int  # byte of the first
    size: int  # samples of a channel


def open_file(path: Path) -> RawFile:
    """Content of a WAV file: integer samples of 16, 24 or 32 bits, or floating-point ones, which are volts."""
    found = _samples(path)
    full = None if found.floating else 2.0 ** (8 * found.width - 1) - 1
    channels = {}
    for i in range(found.count if found.size >= FEWEST else 0):
        name, read = f"channel_{i + 1}", partial(_read, path, found, i)
        channels[name] = RawChannel(name=name, size=found.size, samples=read, full_count=full)
    return RawFile(name=path.name, channels=channels, sample_rate=float(found.rate))


def _samples(path: Path) -> _Samples:
    """What the header says, checked."""
    name = path.name
    form, begin, length = _header(path)
    tag, count, rate, _, align, bits = struct.unpack_from("<HHIIHH", form)
    if tag == _EXTENSIBLE and len(form) >= 26:
        (tag,) = struct.unpack_from("<H", form, 24)
    if tag not in _WIDTHS:
        raise ValueError(f"{name}: its samples are packed or coded (format {tag:#06x}); {_EXPORT}")
    if not count or align % count:
        raise ValueError(f"{name} is not a readable WAV file: {count} channels in {align} bytes")
    width = align // count
    if tag == _PCM and width == 1:
        raise ValueError(f"{name} has samples of 8 bits, too coarse for vibration; export 16 or 24 bits")
    if width not in _WIDTHS[tag]:
        raise ValueError(f"{name} has samples of {bits} bits in {width} bytes; {_EXPORT}")
    size = length // align
    if path.stat().st_size < begin + size * align:
        raise ValueError(f"{name} is not a whole WAV file: it ends before its {size} samples a channel")
    return _Samples(floating=tag == _FLOAT, count=count, rate=rate, width=width, begin=begin, size=size)


def _header(path: Path) -> tuple[bytes, int, int]:
    """The form of the samples as the file has it, the first byte of these and their length."""
    name = path.name
    form, sizes = b"", b""
    with path.open("rb") as file:
        head = file.read(12)
        other = next((kind for mark, kind in _OTHERS.items() if head.startswith(mark)), "")
        if other:
            raise ValueError(f"{name} is not a readable WAV file: it is {other}; export WAV, 16 or 24 bits")
        if head[:4] not in (b"RIFF", b"RF64", b"BW64") or head[8:] != b"WAVE":
            raise ValueError(f"{name} is not a readable WAV file: it does not begin as one")
        for kind, begin, length in islice(_chunks(file), _MOST):
            if kind == b"ds64":
                sizes = file.read(min(length, 24))
            elif kind == b"fmt ":
                form = file.read(min(length, 40))
            elif kind == b"data":
                if len(form) < 16:
                    raise ValueError(f"{name} is not a readable WAV file: nothing says what its samples are")
                whole = struct.unpack_from("<Q", sizes, 8)[0] if length == 0xFFFFFFFF and len(sizes) == 24 else length
                size = path.stat().st_size
                unfinished = struct.unpack_from("<I", head, 4)[0] != size - 8
                return form, begin, size - begin if unfinished and _streamed(whole, size - begin) else whole
    raise ValueError(f"{name} is not a readable WAV file: it has no samples in its first {_MOST} parts")


def _streamed(length: int, rest: int) -> bool:
    """True of a length that stands for one that was not known yet: recorders that write into a pipe, or that were cut
    off, leave no other."""
    return length in (0, 0xFFFFFFFF, 0xFFFFFFFFFFFFFFFF) or rest < 0x7FFFE000 <= length <= 0x80000000


def _chunks(file: BinaryIO) -> Iterator[tuple[bytes, int, int]]:
    """Name, first byte and length of each part of a file, which stands there."""
    while len(head := file.read(8)) == 8:
        kind, length = struct.unpack("<4sI", head)
        begin = file.tell()
        yield kind, begin, length
        file.seek(begin + length + length % 2)


def _read(path: Path, found: _Samples, column: int, start: int, stop: int) -> NDArray[np.generic]:
    start, stop, _ = slice(start, stop).indices(found.size)
    if stop <= start:
        return np.zeros(0)
    shape = (found.size, found.count, found.width)
    raw = np.memmap(path, dtype=np.uint8, mode="r", offset=found.begin, shape=shape)[start:stop, column]
    if found.floating:
        return np.ascontiguousarray(raw).view(f"<f{found.width}").reshape(-1)
    padded = np.zeros((raw.shape[0], 4), dtype=np.uint8)
    padded[:, 4 - found.width :] = raw  # the top bytes of a 32-bit number, so that the sign comes out
    return padded.reshape(-1).view("<i4") >> (8 * (4 - found.width))
