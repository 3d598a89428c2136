"""A folder for results holds one whole result, and no command writes over what it has read."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from command_words import toml_file
from sentences import hear, refuses

import rotorfit as rf
from rotorfit.apps.cli.main import main
from rotorfit.apps.study_files.folder import CONTENTS, complete_folder
from rotorfit.base.atomic_file import file_name, protected_inputs, whole_file


def fill(out: Path, **files: str) -> None:
    with complete_folder(out) as folder:
        for name, text in files.items():
            (folder / name).write_text(text, encoding="utf-8")


def held(folder: Path) -> dict[str, str]:
    return {file.name: file.read_text() for file in folder.iterdir() if file.name != CONTENTS}


def test_a_result_replaces_the_one_before_as_a_whole(tmp_path: Path) -> None:
    out = tmp_path / "results"
    fill(out, fit="1", bootstrap="1")
    (out / "notes").write_text("mine")
    fill(out, fit="2")
    assert held(out) == {"fit": "2", "notes": "mine"}
    assert held(tmp_path / "results.previous") == {"fit": "1", "bootstrap": "1"}
    fill(out, fit="3")
    assert held(out) == {"fit": "3", "notes": "mine"}
    assert held(tmp_path / "results.previous") == {"fit": "2"}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["results", "results.previous"]


@pytest.mark.parametrize("failing", range(2))
def test_a_rename_that_fails_leaves_the_result_that_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, failing: int
) -> None:
    out = tmp_path / "results"
    fill(out, fit="1", table="1")
    calls = []
    rename = os.rename

    def unreliable(source: Path, target: Path) -> None:
        calls.append(source)
        if len(calls) == failing + 1:
            raise OSError(5, "input/output error")
        rename(source, target)

    monkeypatch.setattr(os, "rename", unreliable)
    with refuses(OSError):
        fill(out, fit="2", table="2")
    monkeypatch.undo()
    assert held(out) == {"fit": "1", "table": "1"}
    assert [path.name for path in tmp_path.iterdir()] == ["results"]


@pytest.mark.parametrize("plane", ["p" * 300, "C:\\x", "\u00e4" * 200])
def test_names_of_planes_give_names_of_recordings_that_work(tmp_path: Path, plane: str) -> None:
    values = {"M": 1.2, "K": 8e3, "Ds": 8.0, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}
    options = {"speed_rpm": [600.0], "duration": 1.0}
    files = rf.simulate_recordings(rf.models.OneMode(planes=(plane,)), values, tmp_path, "balance", **options)
    assert sorted(tmp_path.iterdir()) == sorted([*files, tmp_path / "rig.toml"])
    assert [rf.read_recording(file).planes for file in files] == [(plane,), (plane,)]
    with refuses(ValueError):
        rf.simulate_recordings(rf.models.OneMode(planes=("../x",)), values, tmp_path, "balance", **options)


@pytest.mark.parametrize("plane", ["a/b", "../x", "p" * 300])
def test_names_of_planes_give_names_of_figures_that_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, plane: str
) -> None:
    monkeypatch.setattr("rotorfit.show.plots.style.picture_of", lambda figure, *, dpi: b"")  # drawing takes seconds
    turns = 20 * np.pi * np.arange(4096) / 1024.0
    volts = np.column_stack([turns, np.cos(turns), np.sin(turns), np.where(turns % (2 * np.pi) < 0.3, -8.0, -2.0)])
    volts[:, 0] /= 20 * np.pi
    np.savetxt(tmp_path / "volts.csv", volts, "%.5f", ",", header="time_s,p_X,p_Y,keyphasor", comments="")
    probe = f'[[probe]]\nplane = "{plane}"\nsensitivity_V_per_mm = 7.87\n'
    probes = [f'{probe}channel = "p_{axis}"\nangle_deg = {angle}\n' for axis, angle in (("X", 0), ("Y", 90))]
    (tmp_path / "rig.toml").write_text('rotation = "ccw"\n' + "".join(probes), encoding="utf-8")
    out = tmp_path / "looks"
    words = ["look", str(tmp_path / "volts.csv"), "--setup", str(tmp_path / "rig.toml"), "--quiet", "--out", str(out)]
    assert main(words) in (0, 1)
    assert len(list(out.glob("cascade*.png"))) == 1
    assert {path.name for path in tmp_path.iterdir()} == {"volts.csv", "rig.toml", "looks"}


def test_different_names_give_different_files() -> None:
    """Names that differ only in capitals are one file on some systems."""
    given = ["a/b", "a-b", "a:b", "p" * 200, "p" * 300, "..", "", "rec", "REC"]
    names: list[str] = []
    for name in given:
        names.append(file_name(name, names))
    assert names == ["a-b", "a-b-2", "a-b-3", "p" * 100, "p" * 100 + "-2", "", "-2", "rec", "REC-2"]


@pytest.mark.parametrize("letter", ["x", "\u00f8"])
def test_names_as_long_as_the_file_system_takes_are_written(tmp_path: Path, letter: str) -> None:
    """The draft beside a file has a longer beginning, and no longer name."""
    longest = letter * ((255 - len(".previous")) // len(letter.encode()))
    with whole_file(tmp_path / f"{longest[:-4]}.csv") as draft:
        draft.write_text("content")
    for content in ("old", "new"):
        with complete_folder(tmp_path / longest) as folder:
            (folder / "a.txt").write_text(content)
    with (
        pytest.raises(OSError, match=rf"File name too long: '{tmp_path}/x{{300}}\.csv'"),
        whole_file(tmp_path / f"{'x' * 300}.csv") as draft,
    ):
        draft.write_text("content")
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {f"{longest[:-4]}.csv", longest, f"{longest}.previous"}
    assert (tmp_path / longest / "a.txt").read_text() == "new"


class Killed(BaseException):
    """The end of a process, of which nothing is cleaned up."""


@pytest.mark.parametrize("last", range(3))
def test_a_kill_between_renames_loses_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, last: int) -> None:
    """The kill comes after each of the renames in turn; what is not of the result is there after two more runs."""
    out = tmp_path / "results"
    fill(out, fit="1")
    (out / "notes").write_text("mine")
    rename = os.rename
    calls: list[Path] = []

    def killed(source: Path, target: Path) -> None:
        if len(calls) > last:
            raise Killed
        calls.append(source)
        rename(source, target)
        if len(calls) > last:
            raise Killed

    monkeypatch.setattr(os, "rename", killed)
    with pytest.raises(Killed):
        fill(out, fit="2")
    monkeypatch.undo()
    whole = out if last else tmp_path / "results.previous"
    assert held(whole)["fit"] == ("2" if last else "1")
    for text in ("3", "4"):
        fill(out, fit=text)
    assert held(out) == {"fit": "4", "notes": "mine"}
    assert held(tmp_path / "results.previous") == {"fit": "3"}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["results", "results.previous"]


def test_a_stop_between_renames_puts_the_result_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "results"
    fill(out, fit="1")
    rename = os.rename

    def stopped(source: Path, target: Path) -> None:
        if source.name.startswith(".rotorfit"):
            raise KeyboardInterrupt
        rename(source, target)

    monkeypatch.setattr(os, "rename", stopped)
    with pytest.raises(KeyboardInterrupt):
        fill(out, fit="2")
    assert held(out) == {"fit": "1"}


def test_what_the_system_says_of_a_draft_is_said_of_the_file_itself(tmp_path: Path) -> None:
    out = tmp_path / "results"
    with refuses(FileNotFoundError), complete_folder(out) as folder:
        (folder / "nowhere" / "curves.csv").write_text("1")
    with refuses(FileNotFoundError), whole_file(tmp_path / "a.csv") as draft:
        draft.unlink(missing_ok=True)


def test_two_runs_into_one_folder_leave_the_result_of_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "results"
    fill(out, fit="1")
    with complete_folder(out) as folder:
        (folder / "fit").write_text("2", encoding="utf-8")
        with monkeypatch.context() as other:
            other.setattr(os, "getpid", lambda: 1)
            fill(out, fit="3", bootstrap="3")
    assert held(out) == {"fit": "2"}
    assert held(tmp_path / "results.previous") == {"fit": "3", "bootstrap": "3"}


def test_what_others_put_beside_the_former_result_is_not_removed(tmp_path: Path) -> None:
    out = tmp_path / "results"
    for text in "12":
        fill(out, fit=text)
    for folder in (out, tmp_path / "results.previous"):
        (folder / "notes").write_text("mine")
    with refuses(FileExistsError):
        fill(out, fit="3")
    assert held(out) == {"fit": "2", "notes": "mine"}


def test_files_that_are_no_result_are_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "fit").write_text("mine")
    with refuses(FileExistsError):
        fill(tmp_path, fit="1")
    assert held(tmp_path) == {"fit": "mine"}
    out = tmp_path / "results"
    fill(out, fit="1")
    (tmp_path / "results.previous").mkdir()
    (tmp_path / "results.previous" / "mine").write_text("mine")
    with refuses(FileExistsError):
        fill(out, fit="2")
    shutil.rmtree(tmp_path / "results.previous")
    monkeypatch.chdir(out)
    with refuses(FileExistsError):
        fill(out, fit="2")


def test_what_was_read_is_safe_in_the_former_result_too(tmp_path: Path) -> None:
    out, previous = tmp_path / "results", tmp_path / "results.previous"
    for text in "12":
        fill(out, fit=text)
    with (
        protected_inputs([previous / "fit"]),
        refuses(FileExistsError),
    ):
        fill(out, fit="3")
    assert (held(previous), held(out)) == ({"fit": "1"}, {"fit": "2"})


def test_files_of_a_result_keep_their_modes(tmp_path: Path) -> None:
    out = tmp_path / "results"
    fill(out, fit="1", table="1")
    (out / "fit").chmod(0o600)
    out.chmod(0o700)
    fill(out, fit="2", table="2")
    assert [path.stat().st_mode & 0o777 for path in (out, out / "fit")] == [0o700, 0o600]


def test_a_damaged_list_of_files_is_no_result(tmp_path: Path) -> None:
    out = tmp_path / "results"
    fill(out, fit="1")
    (out / CONTENTS).write_bytes(b"\xff\xfe\n../../x\n")
    with refuses(FileExistsError):
        fill(out, fit="2")
    assert held(out) == {"fit": "1"}


def test_simulated_recordings_replace_those_before_as_a_whole(tmp_path: Path) -> None:
    out = tmp_path / "volts"
    rotor = {"M": 1.2, "K": 8e3, "Ds": 8, "K0": 9e3, "D": 450, "lam": 0.46, "Mf": 0.4}
    for speed in (600, 900):
        test = {"kind": "static-load", "load": 1, "duration": 0.2, "speed_rpm": speed}
        virtual = toml_file(tmp_path / "virtual.toml", model="one-mode", params=rotor, test=test)
        words = ["simulate", str(virtual), "--quiet", "--recordings"]
        assert main([*words, str(out)]) == 0
    former = out.with_name("volts.previous")
    assert {file.name for file in out.iterdir()}.isdisjoint({file.name for file in former.glob("*.h5")})
    (tmp_path / "mine").mkdir()
    setup = tmp_path / "mine" / "rig.toml"
    setup.write_text("# of my own", encoding="utf-8")
    assert main([*words, str(setup.parent)]) == 2
    assert [file.read_text() for file in setup.parent.iterdir()] == ["# of my own"]


def test_the_page_of_a_store_never_takes_the_place_of_the_store(tmp_path: Path) -> None:
    study, store = tmp_path / "study.toml", tmp_path / "machine.html"
    study.write_text('model = "one-mode"', encoding="utf-8")
    (tmp_path / "inbox").mkdir()
    words = ["watch", str(tmp_path / "inbox"), "--study", str(study), "--once", "--settle", "0", "--store", str(store)]
    assert main(words) == 2
    assert rf.Store(store).tests == ()


def test_a_file_that_is_replaced_keeps_its_mode_and_the_links_to_it(tmp_path: Path) -> None:
    file, link = tmp_path / "private", tmp_path / "link"
    file.write_text("1")
    file.chmod(0o600)
    link.symlink_to(file)
    with whole_file(link) as draft:
        draft.write_text("2")
    assert link.is_symlink()
    assert (file.read_text(), file.stat().st_mode & 0o777) == ("2", 0o600)


@pytest.mark.parametrize("through", ["name", "symlink", "hard link"])
def test_no_output_replaces_an_input(tmp_path: Path, through: str) -> None:
    source, out = tmp_path / "in.csv", tmp_path / "out.csv"
    shutil.copyfile(rf.datasets.path("rig_open.csv"), source)
    before = source.read_bytes()
    if through == "symlink":
        out.symlink_to(source)
    elif through == "hard link":
        out.hardlink_to(source)
    else:
        out = source
    assert main(["join", str(source), "--out", str(out)]) == 2
    assert source.read_bytes() == before
    with protected_inputs([source]), refuses(FileExistsError):
        rf.write(rf.read(rf.datasets.path("rig_open.csv")), out)


def test_commands_refuse_to_write_over_what_they_read(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    volts = tmp_path / "volts.h5"
    shutil.copyfile(rf.datasets.path("volts_journal-fwd.h5"), volts)
    responses = tmp_path / "responses.csv"
    shutil.copyfile(rf.datasets.path("rig_open.csv"), responses)
    before = volts.read_bytes(), responses.read_bytes()
    fit = ["fit", str(responses), "--model", "whirl-whip", "--known", "K3=6000", "--no-figures", "--out", str(tmp_path)]
    for command in (["vectors", str(volts), "--out", str(tmp_path / "volts.mat")], fit):
        if command[0] == "vectors":
            (tmp_path / "volts.mat").symlink_to(volts)
        assert main(command) == 2
        hear(capsys.readouterr().err)
        assert (volts.read_bytes(), responses.read_bytes()) == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["responses.csv", "volts.h5", "volts.mat"]


def test_a_forward_test_alone_of_anisotropic_coefficients_is_written(tmp_path: Path) -> None:
    """No line has forces along both axes, so that there is no stiffness against frequency; it was a traceback."""
    w, stiffness, damping = np.linspace(20, 300, 40), np.array([[17e3, 6e3], [-6e3, 19e3]]), np.diag([98.0, 95.0])
    dynamic = stiffness + 1j * w[:, None, None] * damping - w[:, None, None] ** 2 * np.diag([1.2, 1.25])
    along = np.linalg.solve(dynamic, np.broadcast_to(np.array([[5.0], [-5j]]), (w.size, 2, 1)))[..., 0]
    rng = np.random.default_rng(1)
    parts = [
        rf.perturbation_test(
            run="forward", speed=150.0, frequency=w, force_plane="journal", force=5.0, plane="journal",
            direction=direction, response=along[:, i] + 2e-8 * (rng.normal(size=40) + 1j * rng.normal(size=40)),
            sigma=2e-8,
        )
        for i, direction in enumerate("xy")
    ]  # fmt: skip
    rf.write(rf.join_runs(parts), tmp_path / "forward.csv")
    command = ["fit", str(tmp_path / "forward.csv"), "--model", "anisotropic", "--no-figures", "--quiet"]
    assert main([*command, "--out", str(tmp_path / "out")]) == 0
    assert not (tmp_path / "out" / "frequency_coefficients.csv").exists()


def test_drafts_that_a_kill_left_are_swept_a_day_later(tmp_path: Path) -> None:
    import time

    from rotorfit.apps.study_files.folder import complete_folder

    old = time.time() - 2 * 24 * 3600
    gone = [tmp_path / ".123-456-a.csv", tmp_path / ".rotorfit-99-out"]
    kept = [
        tmp_path / ".124-456-a.csv",
        tmp_path / ".rotorfit-98-out",
        tmp_path / ".123-456-b.csv",
        tmp_path / ".a.csv",
    ]
    for path in (*gone, *kept):
        path.mkdir() if "rotorfit" in path.name else path.touch()
    for path in (*gone, *kept[2:]):
        os.utime(path, (old, old))
    with whole_file(tmp_path / "a.csv") as draft:
        draft.write_text("x")
    with complete_folder(tmp_path / "out") as folder:
        (folder / "b").write_text("y")
    assert not any(path.exists() for path in gone)
    assert all(path.exists() for path in kept)


@pytest.mark.parametrize("after", [0, 2])
def test_a_disk_that_is_full_when_figures_are_drawn_leaves_tables_and_fit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], after: int
) -> None:
    write, drawn = Path.write_bytes, []

    def full(path: Path, content: bytes) -> int:
        drawn.append(path)
        if len(drawn) > after:
            raise OSError(28, "No space left on device")
        return write(path, content)

    monkeypatch.setattr(Path, "write_bytes", full)
    file, out = rf.datasets.path("rig_lumped.csv"), tmp_path / "out"
    assert main(["fit", str(file), "--model", "whirl-whip", "--known", "K3=6000", "--quiet", "--out", str(out)]) == 0
    assert "figures and report were not written, tables and fit.json were: No space left" in capsys.readouterr().err
    names = {path.name for path in out.iterdir()}
    assert {"summary.txt", "parameters.csv", "fit.json"} <= names
    assert not {name for name in names if name.endswith((".png", ".html"))}
