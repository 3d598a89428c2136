"""Fits of runs as they are kept while a campaign is under way: by what was fitted and how, exact, without pickle."""

from __future__ import annotations

import hashlib
import json
import zlib
from collections.abc import Mapping
from typing import Any

from rotorfit.estimators.file_reading import decompressed, reading
from rotorfit.fitting.json_values import decode, encode
from rotorfit.models import RotorModel
from rotorfit.version import __version__


def key_of(model: RotorModel, options: Mapping[str, Any]) -> str:
    """Key of a fit by its model, options and version; a run adds its readings: :func:`run_key`."""
    return json.dumps([__version__, encode(model), encode(dict(options))], sort_keys=True)


def run_key(common: str, content: str) -> str:
    """Hash by which the fit of a run with such readings is found again."""
    return hashlib.sha256(f"{common}{content}".encode()).hexdigest()


def to_bytes(fields: Mapping[str, Any]) -> bytes:
    """Fields of a record as compressed JSON."""
    return zlib.compress(json.dumps(encode(dict(fields)), allow_nan=False).encode("utf-8"))


def from_bytes(data: bytes) -> dict[str, Any]:
    """The fields of :func:`to_bytes`."""
    name = "a fit that the store keeps"
    with reading(name, "fit of a run"):
        found: dict[str, Any] = decode(json.loads(decompressed(name, data, len(data))))
    return found
