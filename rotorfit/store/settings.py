"""Identity of settings and of files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from rotorfit.fitting.json_values import encode
from rotorfit.options.kinds import is_set
from rotorfit.options.table import StudyOptions
from rotorfit.recordings.signals import SAMPLES_OF_A_PIECE
from rotorfit.studies.study import Study


def settings_key(study: Study) -> tuple[str, str]:
    """Hash of the settings of a study, and the settings as JSON; files and folders do not count."""
    given = {f.name: _sorted(encode(getattr(study, f.name))) for f in fields(StudyOptions) if _says(study, f.name)}
    if study.structure:  # what the file holds counts, not where it is
        shaft = Path(study.structure)
        files = sorted(shaft.iterdir()) if shaft.is_dir() else [shaft]
        given["structure"] = _sha256("".join(digest_of(file)[1] for file in files if file.is_file()))
    text = json.dumps({"model": study.model, **given}, sort_keys=True, allow_nan=False)
    return _sha256(text), text


def _says(study: Study, name: str) -> bool:
    value = getattr(study, name)
    default = next(f for f in fields(StudyOptions) if f.name == name).default
    return is_set(value) and value != default


def _sorted(value: Any) -> Any:
    """JSON of which no order of keys counts."""
    if isinstance(value, Mapping):
        return {
            key: sorted(map(_sorted, item), key=json.dumps) if key == "mapping" else _sorted(item)
            for key, item in value.items()
        }
    return [_sorted(item) for item in value] if isinstance(value, list) else value


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8")).hexdigest()


def digest_of(path: Path, length: int | None = None) -> tuple[int, str]:
    """Size and SHA-256 of a file, or of so many bytes at its beginning."""
    digest, size = hashlib.sha256(), 0
    with path.open("rb") as stream:
        while piece := stream.read(SAMPLES_OF_A_PIECE if length is None else min(SAMPLES_OF_A_PIECE, length - size)):
            digest.update(piece)
            size += len(piece)
    return size, digest.hexdigest()
