"""The front in a browser, headless, with a mouse: from volts to a report, and the TOML that repeats it."""

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

import numpy as np
import pandas as pd
import pytest
from browser import Browser, Tab

import rotorfit as rf
from rotorfit import datasets

pytest.importorskip("panel", reason="of the extra app")
pytest.importorskip("tomli_w", reason="of the extra app")

VOLTS = ("volts_disk-fwd.h5", "volts_journal-fwd.h5")
Run = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder that is opened: recordings, a test, one whose journal y is inverted, and one that is none."""
    made = tmp_path_factory.mktemp("rig")
    for name in VOLTS:
        shutil.copy(datasets.path(name), made / name)
    table = pd.read_csv(datasets.path("rig_lumped.csv"), comment="#")
    table.to_csv(made / "a.csv", index=False)
    inverted = (table["plane"] == "journal") & (table["direction"] == "y")
    table.assign(phase_deg=table["phase_deg"] + 180.0 * inverted).to_csv(made / "b.csv", index=False)
    (made / "wrong.csv").write_text("speed_rpm,amplitude_um\n1000,1\n", encoding="utf-8")
    samples = pd.DataFrame({"time_s": np.arange(2000) / 1000, **dict.fromkeys(("disk_X", "mark_shaft"), 1.0)})
    samples.to_csv(made / "raw.csv", index=False)
    return made


@pytest.fixture(scope="module")
def address(folder: Path) -> Iterator[str]:
    """Address of a server for the folder, which has no traceback printed in the end."""
    words = [sys.executable, "-m", "rotorfit", "open", str(folder / "a.csv"), "--no-browser"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(words, **pipes, text=True, env=os.environ) as server:
        assert server.stdout is not None
        yield server.stdout.readline().split()[-1]
        server.terminate()
        assert "Traceback" not in server.communicate()[1]


def open_files(tab: Tab, *names: str) -> None:
    """Choose files in the list, the first by a click and the others with Ctrl, and open them."""
    for number, name in enumerate(names):
        tab.click("option", name, ctrl=number > 0)
    tab.click("button", "Open")


def downloaded(tab: Tab, name: str, folder: Path) -> Path:
    """Click on a download and wait for the file."""
    tab.downloads_to(folder)
    tab.click("a, button", f"Download {name}")
    return Path(tab.wait(lambda: (folder / name).is_file() and folder / name, f"the download of {name}"))


def repeated(tab: Tab, folder: Path, run: Run) -> rf.FitResult:
    """The fit that is downloaded, which the downloaded study gives again to the last digit."""
    fitted, study = (downloaded(tab, name, folder) for name in ("fit.json", "study.toml"))
    code, _, stderr = run("run", study, "--out", folder / "again", "--no-figures")
    assert (code, stderr) == (0, "")
    kept, again = (json.loads(path.read_text(encoding="utf-8")) for path in (fitted, folder / "again" / "fit.json"))
    assert kept["params"] == again["params"]
    assert kept["covar"] == again["covar"]
    return rf.load_fit(fitted)


def test_from_volts_to_a_report_and_again_on_the_command_line(
    browser: Browser, address: str, folder: Path, tmp_path: Path, run: Run
) -> None:
    before = sorted(folder.iterdir())
    tab = browser.tab(address)
    open_files(tab, *VOLTS)
    tab.wait_for("journal-fwd: 10.000 s at 4096 Hz, 6 channels")
    assert "turning of the force" not in tab.wait_for("rms)")  # the form for the setup is folded away
    tab.click("button", "Make vectors")
    tab.wait_for("perturbation test, 696 readings in 2 runs")
    tab.wait(lambda: tab.run("findAll('canvas').length") > 10, "all figures")  # above the form, which they move
    tab.settle()
    tab.write("K3,", "6000")
    tab.click("button", "Fit")
    text = tab.wait_for("The fit is done.")
    assert "95 % interval" in text  # with its result
    tab.wait(lambda: 0 < tab.run("findAll('h2', 'Result')[0].getBoundingClientRect().top") < 200, "the result in sight")
    assert tab.run("findAll('button', 'Fit')[0].getBoundingClientRect().top") < 50
    text = tab.wait_for("Download report.html")
    assert "The fit agrees with the noise." in text, text[-1500:]
    assert text.count("K0, K1 and K2 are those of a lumped chain") <= 1
    fit = repeated(tab, tmp_path, run)
    for name, asked, answer in (
        ("Judge", "Judge", "log. decrement of the least"),
        ("Prediction", "Predict", "prediction.csv"),
    ):
        tab.click("div.bk-tab", name)
        tab.click("button", asked)
        tab.wait_for(answer)
    assert fit.params["lam"].shown().value in text
    report = downloaded(tab, "report.html", tmp_path)
    assert 'id="verdict"' in report.read_text(encoding="utf-8")
    assert sorted(folder.iterdir()) == before
    assert tab.complaints == []
    assert {urlsplit(one).netloc for one in tab.requests if re.match("https?|ws", one)} == {urlsplit(address).netloc}


@pytest.mark.slow  # what it clicks through is in tests/identify/test_undo_errors.py without a browser
def test_brushing_leaves_readings_out_and_a_finding_is_undone(
    browser: Browser, address: str, tmp_path: Path, run: Run
) -> None:
    tab = browser.tab(address)
    tab.wait_for("a.csv: perturbation test, 1920 readings in 8 runs")
    open_files(tab, "b.csv")
    tab.wait_for("b.csv: perturbation test, 1920 readings in 8 runs")
    left, top, width, height = tab.place("canvas")
    tab.drag((left + 0.4 * width, top + 0.2 * height), (left + 0.6 * width, top + 0.8 * height))
    tab.wait(lambda: tab.run("!findAll('button', 'Leave out')[0].disabled"), "readings to be brushed")
    tab.click("button", "Leave out what is brushed")
    tab.wait_for("readings are left out, drawn as crosses")
    tab.write("K3,", "6000")
    tab.click("button", "Fit")
    tab.wait_for("the probes at journal are inverted in y")
    tab.click("button", "Undo this and fit again")
    tab.wait_for("Undone in the data: probes-inverted (inverted in y at journal)")
    assert not re.search(r"--[a-z]|undo = \[|\brf\.", tab.wait_for("The fit agrees with the noise."))
    fit = repeated(tab, tmp_path, run)
    assert fit.redchi < fit.largest_redchi
    assert 1000 < len(fit.experiments[0]) < 1920


def test_wrong_files_and_two_tabs(browser: Browser, address: str, folder: Path, run: Run) -> None:
    """A wrong file is told as the command line tells it but for options, in its own tab; a fit that is stopped leaves
    nothing."""
    before = sorted(folder.iterdir())
    first = browser.tab(address)
    first.wait_for("Values that are known")
    first.click("button", "Fit")
    first.click("button", "Stop")
    text = first.wait_for("It was stopped; nothing was written.")
    second = browser.tab(address)
    second.wait_for("Values that are known")
    open_files(second, "wrong.csv")
    _, _, stderr = run("info", folder / "wrong.csv")
    sentence = " ".join(stderr.removeprefix("rotorfit: ").split())
    sentence, asked, _ = sentence.partition("A column of another name")
    assert asked
    second.wait_for(f"{sentence}Say below which columns have other names")
    assert "a.csv: perturbation test" not in second.text()
    text = first.text()
    assert "a.csv: perturbation test, 1920 readings" in text
    assert sentence not in text
    assert "Download" not in text
    assert sorted(folder.iterdir()) == before
    open_files(second, "raw.csv")
    second.wait_for("raw.csv looks like raw signals")
    second.click("button", "It holds raw signals")
    second.wait_for("channel mark_shaft")
    assert sorted(folder.iterdir()) == before


def test_the_history_beside_a_store_is_shown_and_can_do_nothing(tmp_path: Path) -> None:
    from rotorfit.apps.app.folder import Folder
    from rotorfit.apps.app.parts import document

    for name in ("machine.db", "machine.html", "other.html"):
        (tmp_path / name).write_text("<script>alert('x')</script>", encoding="utf-8")
    assert Folder(tmp_path).histories() == ["machine.html"]
    shown = document(tmp_path / "machine.html").object
    assert 'sandbox=""' in shown
    assert "<script>" not in shown


def test_the_cursor_of_a_sweep_stands_at_the_speed_of_its_time() -> None:
    from rotorfit.apps.app.signals import VectorFigures
    from rotorfit.show.plots.recordings import vectors_shown

    record = rf.read_recording(datasets.path(VOLTS[0]))
    mark = record.marks.named("perturbator", record)
    figure = VectorFigures(vectors_shown(record, record.marks, "perturbator", None), "disk", mark)
    for pulse in (100, 250, 380):
        begin, end = mark.pulses[pulse : pulse + 2]
        figure.move((begin + end) / 2)
        turning, shown = 60 / (end - begin), figure.cursor.data["x"][0]  # rpm, from one pulse to the next
        between = np.abs(np.diff(figure.rpm)).max()  # where a line is left out, the next one is shown
        assert abs(shown - turning) < between < 0.1 * turning
        assert np.isfinite(figure.cursor.data["a"]).all()


def test_the_address_is_this_machines_alone_and_a_secret(address: str) -> None:
    parts = urlsplit(address)
    assert parts.hostname == "127.0.0.1"
    assert len(parts.path) > 20
    for path in ("/", "/index", f"{parts.path[:-1]}", "/static/"):
        with pytest.raises(urllib.error.HTTPError, match=r"40[34]") as refused:
            urllib.request.urlopen(f"http://{parts.netloc}{path}")
        refused.value.close()
