"""Results of the benchmarks as files: each says with which command, on what, it was made."""

from __future__ import annotations

import csv
import os
import platform
from collections.abc import Sequence
from dataclasses import asdict, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

RESULTS = Path(__file__).parent / "results"


def environment(*packages: str) -> str:
    """Processor count, Python and packages, in one line."""
    versions = ", ".join(f"{name} {version(name)}" for name in packages)
    return f"{platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}, {versions}"


def write_csv(rows: Sequence[Any], path: Path, *comments: str) -> None:
    """Write dataclass instances, one a row, under comment lines."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        stream.writelines(f"# {comment}\n" for comment in comments)
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow([field.name for field in fields(rows[0])])
        for row in rows:
            writer.writerow([f"{v:.5g}" if isinstance(v, float) else v for v in asdict(row).values()])


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """A Markdown table as lines."""
    return ["| " + " | ".join(cells) + " |" for cells in (header, ["---"] * len(header), *rows)]
