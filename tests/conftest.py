"""What every test process needs: one thread of linear algebra, no collection of what stays, fits that tests share."""

from __future__ import annotations

import gc
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import sentences

if TYPE_CHECKING:
    from browser import Browser

    from rotorfit.identify.fitting.result import FitResult
    from rotorfit.identify.fitting.structure.refine import Refinement

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")  # before NumPy is imported: pytest-xdist's processes fight over the cores
os.environ.setdefault("MPLBACKEND", "agg")


@pytest.fixture
def sketched(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave the pixels of a report's figures out, which take most of the time, where a test is about something else."""
    from report_pages import leave_pixels_out

    leave_pixels_out(monkeypatch)


@pytest.fixture
def run(draw: Callable[..., tuple[int, str, str]], sketched: None) -> Callable[..., tuple[int, str, str]]:
    """Run the command line in this process, without drawing: exit code, standard output, standard error."""
    return draw


@pytest.fixture
def draw(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """The same with figures."""
    from rotorfit.apps.cli.main import main

    def call(*words: str | Path) -> tuple[int, str, str]:
        try:
            code = main([str(word) for word in words])
        except SystemExit as stop:  # argparse's own refusals
            code = int(stop.code or 0)
        return code, *capsys.readouterr()

    return call


@pytest.fixture(scope="session")
def rig_fit() -> FitResult:
    """The bundled finite-element rig as the printed model fits it."""
    import rotorfit as rf

    return rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0})


@pytest.fixture(scope="session")
def rig_refinement(rig_fit: FitResult) -> Refinement:
    """All candidates of structural blocks from there."""
    from rotorfit.identify.fitting.structure.refine import refine

    return refine(rig_fit)


def chromium_program() -> str:
    """The browser; the test is skipped without one, or fails where ROTORFIT_BROWSER=required says so."""
    browser = shutil.which("chromium")
    if browser is None:
        missing = "these tests drive the browser chromium: install it (Debian package chromium)"
        pytest.fail(missing) if os.environ.get("ROTORFIT_BROWSER") == "required" else pytest.skip(missing)
    return browser


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    """A headless browser that is driven with mouse and keyboard; skips as ``chromium`` does."""
    from browser import Browser

    driven = Browser(chromium_program(), tmp_path_factory.mktemp("profile"))
    yield driven
    driven.close()


@pytest.fixture
def chromium(tmp_path: Path) -> Callable[..., tuple[str, list[str]]]:
    """Run a headless browser: what it printed, and the lines of its console.

    Skips on a machine without one, unless ROTORFIT_BROWSER=required says that there has to be one.
    """
    browser = chromium_program()

    def call(page: Path, *options: str) -> tuple[str, list[str]]:
        options = (
            "--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--hide-scrollbars",
            "--enable-logging=stderr", "--v=0", f"--user-data-dir={tmp_path / 'profile'}", *options, page.as_uri(),
        )  # fmt: skip
        done = subprocess.run([browser, *options], capture_output=True, text=True, timeout=120, check=True)
        return done.stdout, [line for line in done.stderr.splitlines() if "CONSOLE" in line]

    return call


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--write-sentences", action="store_true", help="write tests/data/sentences.json anew")


def pytest_configure(config: pytest.Config) -> None:
    sentences.writing = config.getoption("--write-sentences")


def pytest_sessionfinish() -> None:
    """Every process writes the sentences of the tests that it ran."""
    if sentences.writing and sentences.heard:
        sentences.write()


def pytest_collection_finish() -> None:
    """Take modules and tests out of the garbage collector's rounds: a twentieth of the time of the tests."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 100)
