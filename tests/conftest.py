"""What every test process needs: one thread of linear algebra, no collection of what stays, reports without pixels."""

import base64
import gc
import os

import pytest

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")  # before NumPy is imported: pytest-xdist's processes fight over the cores
os.environ.setdefault("MPLBACKEND", "agg")


DOT = base64.b64decode(
    "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNkYPhfDwAChwGA60e6kgAAAABJRU5ErkJggg=="
)
"""A picture of one pixel."""


@pytest.fixture
def sketched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the pixels of a report's figures out, which take most of the time, where a test is about something else."""
    from rotorfit.report import figures

    monkeypatch.setattr(figures, "picture_of", lambda figure: DOT)


def pytest_collection_finish() -> None:
    """Take modules and tests out of the garbage collector's rounds: a twentieth of the time of the tests."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)
