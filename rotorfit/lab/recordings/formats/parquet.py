"""Parquet recordings: a column a channel, with a column of times or a rate, by pyarrow (``rotorfit[parquet]``)."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rotorfit.base.file_reading import check_unpacked
from rotorfit.lab.io.sampling import FEWEST, rate_of, rate_of_times, time_factor
from rotorfit.lab.recordings.formats.raw_file import (
    RawChannel,
    RawFile,
    full_count,
    number_or_text,
    once,
    spooled,
    unit_said,
)


def open_file(path: Path) -> RawFile:
    """Content of a Parquet file; a column is read when it is first asked for."""
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as problem:
        raise ValueError(f"{path.name}: Parquet needs pyarrow; pip install 'rotorfit[parquet]'") from problem
    with parquet.ParquetFile(path) as file:
        schema, size = file.schema_arrow, file.metadata.num_rows
    check_unpacked(path.name, 8.0 * size * len(schema), path.stat().st_size)
    texts = _decoded(schema.metadata)
    said = {key: number_or_text(text) for key, text in texts.items() if not key.startswith(("ARROW:", "pandas"))}
    rate = rate_of(said)
    channels: dict[str, RawChannel] = {}
    for field in schema if size >= FEWEST else ():
        if not (pa.types.is_integer(field.type) or pa.types.is_floating(field.type)):
            continue
        kind = np.dtype(field.type.to_pandas_dtype())
        factor = time_factor(field.name)
        if factor is not None:
            times = np.asarray(_load(path, field.name, size, np.dtype(float))) * factor
            rate = rate_of_times(times, f"{path.name}, column {field.name}")
            continue
        channels[field.name] = RawChannel(
            name=field.name,
            size=size,
            samples=once(partial(_load, path, field.name, size, kind)),
            full_count=full_count(kind),
            unit=unit_said(_decoded(field.metadata)),
        )
    return RawFile(name=path.name, channels=channels, attributes=said, sample_rate=rate)


def _decoded(metadata: dict[bytes, bytes] | None) -> dict[str, str]:
    return {key.decode(): value.decode("utf-8", "replace") for key, value in (metadata or {}).items()}


def _load(path: Path, name: str, size: int, kind: np.dtype[Any]) -> NDArray[Any]:
    from pyarrow import parquet

    def pieces() -> Iterator[NDArray[Any]]:
        with parquet.ParquetFile(path) as file:
            for batch in file.iter_batches(batch_size=1 << 20, columns=[name]):
                yield batch.column(0).to_numpy(zero_copy_only=False)

    return spooled(pieces(), size, kind)
