"""The front lets nothing in: names of files and in files are text, others are not answered, and it reads its folder."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from urllib.parse import urlsplit

import h5py
import numpy as np
import pytest
from browser import Browser
from sentences import refuses

import rotorfit as rf
from rotorfit import datasets
from rotorfit.base.atomic_file import reading_only_within

pytest.importorskip("panel", reason="of the extra app")
pytest.importorskip("tomli_w", reason="of the extra app")


def markup(what: str) -> str:
    """A name that would run as script if it were taken for markup."""
    return f"<img src=x onerror=window.ran='{what}'>"


UNDERLINED = "<u>journal</u>"
"""The same without the sign that a plane may not have where it is an option."""


def write_rig(folder: Path) -> None:
    """A test, a recording with its setup, and a file that is none, with markup wherever a name may stand."""
    rig = datasets.rig_lumped()
    rig = rig.select(np.arange(len(rig)) % 40 < 4)

    def called(column: np.ndarray, old: str, new: str) -> np.ndarray:
        return np.array([new if word == old else word for word in column.tolist()])

    test = replace(
        rig,
        run=called(rig.run, rig.runs[0], markup("run")),
        plane=called(rig.plane, "journal", UNDERLINED),
        force_plane=called(rig.force_plane, "journal", UNDERLINED),
        attributes={name: np.array([markup("value")] * len(rig)) for name in (markup("attribute"), "machine")},
    )
    rf.write(test, folder / "test.csv")
    (folder / "test.csv").rename(folder / f"{markup('test')}.csv")
    wrong = f"speed_rpm,{markup('column')},amplitude_{markup('unit')}\n1000,1,1\n"
    (folder / f"{markup('wrong')}.csv").write_text(wrong, encoding="utf-8")
    t = np.arange(4000) / 1000
    with h5py.File(folder / f"{markup('recording')}.h5", "w") as file:
        for axis, lag in (("X", 0.0), ("Y", 1.57)):
            file[f"{markup('channel')}_{axis}"] = -8 + 0.5 * np.cos(2 * np.pi * 20 * t - lag)
        file.attrs.update({"sample_rate_hz": 1000.0, markup("key"): markup("value")})
    probe = '[[probe]]\nplane = "{0}"\nchannel = "{1}_{2}"\nangle_deg = {3}\nsensitivity_V_per_mm = 8\n'
    probes = [probe.format(markup("plane"), markup("channel"), axis, angle) for axis, angle in (("X", 0), ("Y", 90))]
    attributes = f'[attributes]\n"{markup("key")}" = "{markup("value")}"\n'
    (folder / f"{markup('setup')}.toml").write_text("".join([*probes, attributes]), encoding="utf-8")


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Address of a server for such a folder."""
    folder = tmp_path_factory.mktemp("rig")
    write_rig(folder)
    words = [sys.executable, "-m", "rotorfit", "open", str(folder), "--no-browser"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(words, **pipes, text=True, env=os.environ) as server:
        assert server.stdout is not None
        yield server.stdout.readline().split()[-1]
        server.terminate()
        assert "Traceback" not in server.communicate()[1]


def test_names_are_text_wherever_they_are_shown(browser: Browser, address: str) -> None:
    """Read, unfolded, pointed at, fitted, refused, recorded: nothing runs, nor is anything there that could."""
    tab = browser.tab(address, height=2000)
    for name, words in (("test", "perturbation test, 192 readings"), ("wrong", f"amplitude_{markup('unit')}")):
        tab.click("option", markup(name))
        tab.click("button", "Open")
        tab.wait_for(words)
    tab.click("option", markup("test"))
    tab.click("button", "Open")
    tab.wait_for(f"attributes {markup('attribute')}")
    tab.settle()
    tab.click("h3", f"Correct how {markup('test')}")
    tab.wait_for("run-out from readings below")
    tab.point_at("force at")
    assert f"run: {markup('run')}" in tab.text()
    tab.choose("whirl-whip")
    tab.settle()
    tab.click("h3", "More options")
    tab.wait_for("planes, in the model's order")
    tab.settle()
    tab.write("planes, in", f"disk,{UNDERLINED}")
    tab.settle()
    tab.write("K3,", "6000")
    tab.click("button", "Fit")
    tab.wait_for("Download report.html", 120.0)
    for kind in ("Polar", "Residuals"):
        tab.click(".bk-tab", kind)
        tab.settle()
    tab.choose(markup("setup"))
    tab.click("option", markup("recording"))
    tab.settle()
    tab.click("button", "Open")
    tab.wait_for(f"{markup('plane')} at 90 deg")
    tab.settle()
    tab.click("h3", "Correct which channel is what")
    tab.wait_for(f"channel {markup('channel')}_Y")
    assert tab.run("findAll('*').filter(e => ['IMG', 'U'].includes(e.tagName)).length") == 0
    assert tab.run("window.ran === undefined")
    assert tab.complaints == []  # the policy would complain of what it has held back


def test_what_came_to_be_markup_would_not_run_all_the_same(browser: Browser, address: str) -> None:
    tab = browser.tab(address)
    tab.wait_for("Test files and recordings")
    script = "document.body.appendChild(Object.assign(document.createElement('script'), {text: 'window.ran = 1'}))"
    for put in (f"document.body.innerHTML += {json.dumps(markup('x'))}", script):
        before = len(tab.complaints)
        tab.run(put)
        tab.wait(lambda before=before: "Security Policy" in " ".join(tab.complaints[before:]), "a complaint")
    assert tab.run("window.ran === undefined")


def answered(address: str, path: str = "", **headers: str) -> str:
    """The first line of what the server answers, or nothing."""
    parts = urlsplit(address)
    given = {"Host": parts.netloc, **{name.replace("_", "-"): value for name, value in headers.items()}}
    with socket.create_connection((parts.hostname, parts.port), timeout=30) as asked:
        lines = [f"GET {parts.path}{path} HTTP/1.1", *(f"{name}: {value}" for name, value in given.items()), "", ""]
        asked.sendall("\r\n".join(lines).encode())
        return asked.recv(200).decode(errors="replace").partition("\r\n")[0]


def test_only_pages_of_its_own_are_answered(address: str) -> None:
    """Not of another name for this machine, as that of a server that renames itself; sockets only of its pages."""
    own = f"http://{urlsplit(address).netloc}"
    assert "200" in answered(address)
    assert "403" in answered(address, Host="evil.example")
    assert "403" in answered(address, Host=f"evil.example:{urlsplit(address).port}")
    assert "403" in answered(address, Origin="http://evil.example")
    assert "403" in answered(address, Origin="null")
    assert "200" in answered(address, Origin=own)
    socket_of = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec_WebSocket_Version": "13"}
    socket_of |= {"Sec_WebSocket_Key": base64.b64encode(bytes(16)).decode()}
    expiry = int(time.time()) + 100
    tokens = [
        base64.urlsafe_b64encode(json.dumps(content).encode()).decode().rstrip("=")
        for content in (
            {"session_id": "a", "session_expiry": expiry},
            {"session_id": "a"},
            {"session_id": "a", "session_expiry": 1},
            {"session_id": "a", "session_expiry": "soon"},
            {"session_id": "a", "__bk__zlib_": "x"},
            [],
        )
    ]
    asked = {"Origin": own, "Sec_WebSocket_Protocol": f"bokeh, {tokens[0]}"}
    assert "101" in answered(address, "/ws", **socket_of, **asked)
    assert "403" in answered(address, "/ws", **socket_of, Sec_WebSocket_Protocol=f"bokeh, {tokens[0]}")
    assert "403" in answered(address, "/ws", **socket_of, **{**asked, "Origin": "http://evil.example"})
    for protocol in (
        *(f"bokeh, {token}" for token in (*tokens[1:], "%%%", "a.b.c", "", "x" * 3000)),
        "bokeh",
        "",
        ",,",
    ):
        assert "400" in answered(address, "/ws", **socket_of, **{**asked, "Sec_WebSocket_Protocol": protocol}), protocol


def test_the_browser_is_started_with_a_file_that_only_its_owner_reads(tmp_path: Path) -> None:
    """All users see with which words a program was started."""
    shutil.copy(datasets.path("rig_lumped.csv"), tmp_path / "a.csv")
    browser = tmp_path / "browser"
    keep = 'echo "$1" > words; file=${1#file://}; stat -c %a "$file" "$(dirname "$file")" > modes; cp "$file" page'
    browser.write_text(f"#!/bin/sh\ncd {tmp_path}\n{keep}\n", encoding="utf-8")
    browser.chmod(0o755)
    words = [sys.executable, "-m", "rotorfit", "open", str(tmp_path / "a.csv")]
    environment = {**os.environ, "BROWSER": str(browser)}
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment) as server:
        assert server.stdout is not None
        address = server.stdout.readline().split()[-1]
        end = time.monotonic() + 60
        while not (tmp_path / "page").exists() and time.monotonic() < end:
            time.sleep(0.1)
        time.sleep(0.2)
        server.send_signal(2)
        server.communicate()
    said = (tmp_path / "words").read_text(encoding="utf-8").strip()
    assert said.startswith("file://")
    assert urlsplit(address).path not in said
    assert (tmp_path / "modes").read_text(encoding="utf-8").split() == ["600", "700"]
    assert re.search(r"0; url=([^\"]+)\"", (tmp_path / "page").read_text(encoding="utf-8"))[1] == address  # type: ignore[index]
    assert not Path(said.removeprefix("file://")).exists()


def test_nothing_outside_of_the_folder_is_read(tmp_path: Path) -> None:
    """Not by a setup that names a recording there, nor by a link; in a process of the work as in the server's."""
    from rotorfit.apps.app.folder import Folder
    from rotorfit.apps.app.work import Refusal, Work, read
    from rotorfit.apps.study_files.study_file import study_of

    opened, secret = tmp_path / "opened", tmp_path / "secret"
    for folder in (opened, secret):
        folder.mkdir()
    shutil.copy(datasets.path("volts_disk-fwd.h5"), opened / "a.h5")
    shutil.copy(datasets.path("volts_disk-fwd.h5"), secret / "b.h5")
    (opened / "link.h5").symlink_to(secret / "b.h5")
    for number, file in enumerate(("../secret/b.h5", str(secret / "b.h5"), "link.h5")):
        setup = opened / f"{number}.toml"
        setup.write_text(f'[slow_roll]\nfile = "{file}"\n', encoding="utf-8")
        content = {"model": "whirl-whip", "files": [{"recordings": ["a.h5"], "setup": setup.name}]}
        with reading_only_within(opened), pytest.raises(ValueError, match=r"is not within .*opened"):
            rf.read_recording(opened / "a.h5", setup).run_out  # noqa: B018
        if number == 0:
            work = Work(read, study_of(content, opened), opened)
            news = []
            while not any(isinstance(one, Refusal) for one in news):
                news += work.news()
            work.stop()
            assert "b.h5' is not within" in next(one for one in news if isinstance(one, Refusal)).words
    with reading_only_within(opened):
        for name in ("../secret/b.h5", "link.h5", "no\0name"):
            with pytest.raises(ValueError, match=r"not within|no name"):
                Folder(opened).path(name)
        for read_it in (rf.load_fit, rf.read_recording):
            with pytest.raises(ValueError, match="is not within"):
                read_it(secret / "b.h5")


@pytest.mark.parametrize("port", ["99999", "-1"])
def test_a_port_that_there_is_not_is_refused(port: str, tmp_path: Path) -> None:
    from rotorfit.apps.app.server import serve
    from rotorfit.apps.cli.main import main

    with refuses(ValueError):
        serve([tmp_path], port=int(port), on_ready=print)
    assert main(["open", str(tmp_path), "--no-browser", f"--port={port}"]) == 2
