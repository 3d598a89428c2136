"""The front in a browser, headless, with a mouse: the way from a file to a report, and a TOML that repeats it."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from browser import Browser, Tab

import rotorfit as rf
from rotorfit import datasets

pytest.importorskip("panel", reason="of the extra app")
pytest.importorskip("tomli_w", reason="of the extra app")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that is opened."""
    made = tmp_path_factory.mktemp("rig")
    shutil.copy(datasets.path("rig_lumped.csv"), made / "rig.csv")
    (made / "wrong.csv").write_text("speed_rpm,amplitude_um\n1000,1\n", encoding="utf-8")
    return made


@pytest.fixture(scope="module")
def address(folder: Path) -> Iterator[str]:
    """Address of a server for the folder."""
    words = [sys.executable, "-m", "rotorfit", "open", str(folder / "rig.csv"), "--no-browser"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, env=os.environ) as server:
        assert server.stdout is not None
        yield server.stdout.readline().split()[-1]
        server.terminate()


def downloaded(tab: Tab, name: str, folder: Path) -> Path:
    """Click on a download and wait for the file."""
    tab.downloads_to(folder)
    tab.click("a, button", f"Download {name}")
    return Path(tab.wait(lambda: (folder / name).is_file() and folder / name, f"the download of {name}"))


def test_from_a_file_to_a_report_and_again_on_the_command_line(
    browser: Browser, address: str, folder: Path, tmp_path: Path, run: Callable[..., tuple[int, str, str]]
) -> None:
    before = sorted(folder.iterdir())
    tab = browser.tab(address)
    text = tab.wait_for("Model")
    assert "rig.csv: perturbation test, 1920 readings in 8 runs" in text
    assert "The check of the data found nothing." in text
    tab.write("input", "", "6000", number=field(tab, "K3"))
    tab.click("button", "Fit")
    text = tab.wait_for("Download report.html", 60)
    assert "The fit converged" in text
    fitted = downloaded(tab, "fit.json", tmp_path)
    study = downloaded(tab, "study.toml", tmp_path)
    report = downloaded(tab, "report.html", tmp_path)
    assert "<h2>Verdict</h2>" in report.read_text(encoding="utf-8")
    code, _, stderr = run("run", study, "--out", tmp_path / "again", "--no-figures")
    assert (code, stderr) == (0, "")
    kept, again = (json.loads(path.read_text(encoding="utf-8")) for path in (fitted, tmp_path / "again" / "fit.json"))
    assert kept["params"] == again["params"]
    lam = rf.load_fit(fitted).params["lam"]
    assert f"{lam.value:.2f}" in text
    assert sorted(folder.iterdir()) == before
    assert tab.complaints == []
    assert {urlsplit(one).netloc for one in tab.requests if re.match("https?|ws", one)} == {urlsplit(address).netloc}


def field(tab: Tab, name: str) -> int:
    """Which of the input fields belongs to a parameter."""
    labels = tab.run("findAll('input').map(e => e.getRootNode().querySelector('label')?.textContent || '')")
    return next(i for i, label in enumerate(labels) if label.startswith(f"{name},"))


def test_the_address_is_this_machines_alone_and_a_secret(address: str) -> None:
    parts = urlsplit(address)
    assert parts.hostname == "127.0.0.1"
    assert len(parts.path) > 20
    for path in ("/", "/index", f"{parts.path[:-1]}", "/static/"):
        with pytest.raises(urllib.error.HTTPError, match=r"40[34]"):
            urllib.request.urlopen(f"http://{parts.netloc}{path}")
