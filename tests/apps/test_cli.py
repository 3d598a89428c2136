"""The command line as a user meets it: results, figures, exit codes, sentences in place of tracebacks."""

from __future__ import annotations

import csv
import io
import json
import re
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_words import FIGURES, FIT, RIG, TABLES, TRUTH, WHOLE, Run, perturbed, refused, table
from report_pages import leave_pixels_out
from seal_campaigns import seal_campaign
from sentences import hear, refuses
from slips import thinned

import rotorfit
import rotorfit as rf
from rotorfit import datasets
from rotorfit.apps.cli import main as cli
from rotorfit.apps.cli.answer import ProgressLine
from rotorfit.base.version import RESULTS
from rotorfit.identify.fitting.result import FitResult
from rotorfit.show.report import interactive

ROOT = Path(__file__).parents[2]


# ---- what works -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def demo(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The demo, without drawing: the folder it was told to make its own in, and what it printed."""
    folder, printed, wrong = tmp_path_factory.mktemp("demo"), io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(printed), redirect_stderr(wrong):
        leave_pixels_out(patch)
        assert cli.main(["demo", "--out", str(folder / "results")]) == 0
    assert wrong.getvalue() == ""
    return folder, printed.getvalue()


def test_demo_writes_everything_and_meets_the_truth(demo: tuple[Path, str]) -> None:
    folder, out = demo
    assert {p.name for p in (folder / "results").iterdir()} == TABLES | FIGURES | WHOLE | {"rig_lumped.csv"}
    assert [p.name for p in folder.iterdir()] == ["results"]
    rows = table(folder / "results" / "parameters.csv")
    for name, true in rotorfit.datasets.truth("rig_lumped")["params"].items():
        if rows[name]["status"] != "known":
            assert abs(float(rows[name]["value"]) - true) < 4 * float(rows[name]["stderr"]), name
    assert rows["K3"]["status"] == "known"
    for words in ("closed form", "structural refinement", "<- chosen", "threshold speed", "against the rig's truth"):
        assert words in out
    assert (folder / "results" / "summary.txt").read_text(encoding="utf-8").strip() in out


def test_the_second_rig_of_the_demo_is_no_chain_and_says_so(run: Run, tmp_path: Path) -> None:
    code, printed, _ = run("demo", "--finite-elements", "--no-figures", "--out", tmp_path / "fe")
    assert code == 0
    assert "K0 misses the truth" in printed
    rows = table(tmp_path / "fe" / "parameters.csv")
    for name, tolerance in (("D", 0.002), ("lam", 0.002), ("Mf", 0.025)):
        assert float(rows[name]["value"]) == pytest.approx(TRUTH["params"][name], rel=tolerance)


def test_what_the_report_of_the_demo_says_to_reproduce_it_runs_in_its_folder(
    demo: tuple[Path, str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    folder = demo[0] / "results"
    page = (folder / "report.html").read_text(encoding="utf-8")
    command = page.split("On the command line:</p><pre>")[1].split("</pre>")[0]
    monkeypatch.chdir(folder)
    words = command.split()[1:]
    words[words.index("--out") + 1] = str(tmp_path / "again")
    assert cli.main([*words, "--no-figures", "--quiet"]) == 0
    again, first = rf.load_fit(tmp_path / "again" / "fit.json"), rf.load_fit(folder / "fit.json")
    assert (np.abs(again.x - first.x) < 1e-6 * np.sqrt(np.diag(first.covar))).all()


def test_figures_are_pictures_of_some_size(draw: Run, tmp_path: Path) -> None:
    from PIL import Image

    assert draw(*FIT, "--out", tmp_path, "--quiet")[:2] == (0, "")
    for name in FIGURES:
        with Image.open(tmp_path / name) as picture:
            pixels = np.asarray(picture.convert("RGBA"))
        assert min(pixels.shape[:2]) > 400
        colours = np.ascontiguousarray(pixels).view(np.uint32)  # four bytes a pixel
        assert len(np.unique(colours)) > 10


def test_no_figures_leaves_tables_and_the_report(draw: Run, tmp_path: Path) -> None:
    code, out, err = draw(*FIT, "--no-causes", "--out", tmp_path, "--quiet", "--no-figures")
    assert (code, out) == (0, "")
    assert all(line.startswith("rotorfit: warning: ") for line in err.splitlines())
    assert "redchi is 10.6" in err  # which --quiet does not hide
    assert {file.name for file in tmp_path.iterdir()} == TABLES | WHOLE
    report = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "<img" not in report
    assert "damped frequency, rpm" in report


def test_no_figures_of_a_seal_rig_either(draw: Run, tmp_path: Path) -> None:
    rf.write(seal_campaign(1)[0], tmp_path / "seal.csv")
    words = ["--model", "one-mode", "--stator-mass-kg", "1.2", "--no-figures", "--quiet", "--out", tmp_path / "out"]
    assert draw("fit", tmp_path / "seal.csv", *words)[0] == 0
    written = {file.name for file in (tmp_path / "out").iterdir()}
    assert written == TABLES | WHOLE | {"coefficients.csv", "coefficients_ross.csv"}


def test_json_is_the_python_result(run: Run) -> None:
    code, out, _ = run(*FIT, "--json")
    answer = json.loads(out)
    fit = rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0})
    assert code == 0
    assert set(answer["parameters"]) == set(fit.params)
    for name, p in fit.params.items():
        assert answer["parameters"][name]["value"] == p.value
        assert answer["parameters"][name]["stderr"] == p.stderr
    assert answer["threshold_rpm"]["value"] == pytest.approx(fit.threshold_speed().value * 30 / np.pi, rel=1e-12)
    assert answer["redchi"] == fit.redchi


def test_high_redchi_suggests_refining(run: Run) -> None:
    assert "--refine" in run(*FIT, "--no-causes")[1]
    assert "--refine" not in run(*FIT)[1]  # causes beside the chain explain what it misses


def test_options_reach_the_fit(run: Run, tmp_path: Path) -> None:
    """Each option changes what the library is asked for, compared number by number with the same call in Python."""
    words = (
        "--per D=speed_rpm --bounds lam=0.2:0.6,Mf=:1 --loss huber --start D=400 --phase-offsets --two-lam "
        "--prior sigma=1:0.05 --blocks coupling_mass --known K3=6000,Md=0.9 --bounds lam_D=0:1"
    ).replace("lam=0.2:0.6,", "")
    few = thinned(rf.datasets.rig_open(), 4)
    rf.write(few, tmp_path / "few.csv")
    code, out, _ = run("fit", tmp_path / "few.csv", "--model", "whirl-whip", *words.split(), "--json")
    from scipy.stats import norm

    fit = rf.fit(
        rf.models.WhirlWhip(blocks=("coupling_mass",), two_lam=True), rf.read(tmp_path / "few.csv"),
        known={"K3": 6000.0, "Md": 0.9}, per={"D": "speed_rpm"}, loss="huber", start={"D": 400.0}, phase_offsets=True,
        bounds={"Mf": (-np.inf, 1.0), "lam_D": (0.0, 1.0)}, priors={"sigma": norm(1.0, 0.05)},
    )  # fmt: skip
    assert code == 0
    values = {name: p["value"] for name, p in json.loads(out)["parameters"].items()}
    assert values == {name: p.value for name, p in fit.params.items()}
    assert {"D[speed_rpm=1000]", "D[speed_rpm=2000]", "lam_D", "m12"} <= set(values)


def test_undetermined_parameters_carry_no_number(run: Run, tmp_path: Path) -> None:
    """Journal force alone leaves Md, Ds, K1, sigma and K0 along one null direction."""
    rig = perturbed()
    rf.write(rig.select(rig.force_plane == "journal"), tmp_path / "journal.csv")
    words = ["fit", tmp_path / "journal.csv", "--model", "whirl-whip", "--known", "K3=6000"]
    code, out, _ = run(*words, "--out", tmp_path / "out", "--json")
    answer = json.loads(out)
    assert code == 0
    for name in ("Md", "Ds", "K1", "sigma", "K0"):
        assert answer["parameters"][name]["value"] is None
        assert name in answer["unresolved"]
        assert table(tmp_path / "out" / "parameters.csv")[name]["value"] == ""
        assert table(tmp_path / "out" / "parameters.csv")[name]["status"] == "not determined"
    with (tmp_path / "out" / "covariance.csv").open(encoding="utf-8") as stream:
        assert "K1" not in stream.readline().strip().split(",")


def test_covariance_agrees_with_the_standard_errors(run: Run, tmp_path: Path) -> None:
    run(*FIT, "--out", tmp_path, "--quiet")
    rows = table(tmp_path / "parameters.csv")
    with (tmp_path / "covariance.csv").open(encoding="utf-8", newline="") as stream:
        head, *lines = list(csv.reader(stream))
    for i, (name, *values) in enumerate(lines):
        assert name == head[i + 1]
        assert float(values[i]) ** 0.5 == pytest.approx(float(rows[name]["stderr"]), rel=1e-9)


def test_two_files_are_fitted_together(run: Run, tmp_path: Path) -> None:
    rig = rf.datasets.rig_open()
    files = []
    for rpm in (1000, 2000):
        files.append(tmp_path / f"{rpm}.csv")
        rf.write(rig.select(np.isclose(rig.speed * 30 / np.pi, rpm)), files[-1])
    code, out, _ = run("fit", *files, "--model", "whirl-whip", "--known", "K3=6000", "--json")
    whole = json.loads(run(*FIT, "--json")[1])
    assert code == 0
    for name, p in json.loads(out)["parameters"].items():
        # the noise of each file is estimated on its own, so the weights differ a little
        assert p["value"] == pytest.approx(whole["parameters"][name]["value"], abs=0.5 * p["stderr"] + 1e-9)


def test_info_tells_of_a_conjugated_response(run: Run, tmp_path: Path) -> None:

    rig = perturbed()
    rf.write(replace(rig, response=rig.response.conj(), force=rig.force.conj()), tmp_path / "conjugated.csv")
    code, out, _ = run("info", tmp_path / "conjugated.csv", RIG)
    assert code == 1
    bad, good = out.split("\n\n")
    assert "4032 readings in 8 runs" in good
    assert "check: nothing found" in good
    assert "check: error" in bad
    assert "conjugate" in bad


def test_models_lists_every_parameter(run: Run) -> None:
    code, out, _ = run("models")
    assert code == 0
    for name, model in rf.models.MODELS.items():
        assert name in out
        for parameter in model():
            words = " +".join(re.escape(word) for word in (parameter.name, parameter.unit, parameter.meaning))
            assert re.search(f"^  {words}", out, re.MULTILINE)
    assert run("models", "whirl-whip")[1].count("planes") == 1


def test_anisotropic_takes_the_planes_of_the_data(run: Run, tmp_path: Path) -> None:
    rf.write(thinned(perturbed(), 6), tmp_path / "thin.csv")
    code, out, _ = run("fit", tmp_path / "thin.csv", "--model", "anisotropic", "--json")
    assert code == 0
    assert len(json.loads(out)["parameters"]) == 3 * 16


def test_module_and_version() -> None:
    done = subprocess.run([sys.executable, "-m", "rotorfit", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout == f"rotorfit {rf.__version__}, results {RESULTS}\n"


def test_output_cut_short_is_no_error() -> None:
    script = f"{sys.executable} -m rotorfit models | head -n 1; exit ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


# ---- exit codes -------------------------------------------------------------------------------


def test_a_fit_that_does_not_converge_says_so(run: Run, tmp_path: Path) -> None:
    astray = ("--start", "K1=100,K2=100,Md=0.1,Mb=5,D=1", "--max-iterations", "1")
    code, out, err = run(*FIT, *astray, "--out", tmp_path)
    assert code == cli.ExitCode.NOT_CONVERGED
    assert "did not converge" in err
    assert "did not converge" in out
    assert "did not converge" in (tmp_path / "summary.txt").read_text(encoding="utf-8")


def test_interruption_leaves_nothing(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("rotorfit.apps.cli.fits.write_outcome", interrupted)
    code, _, err = run(*FIT, "--out", tmp_path / "out")
    assert (code, err) == (cli.ExitCode.INTERRUPTED, "rotorfit: interrupted, nothing was written\n")
    assert list(tmp_path.iterdir()) == []


# ---- bad input --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("--known k3=6000", "did you mean 'K3'"),
        ("--known K3", "--known takes NAME=VALUE, got 'K3'"),
        ("--known K3=stiff", "'stiff' is not a number"),
        ("--known K3=1 --known K3=2", "names K3 twice"),
        ("--bounds lam=0.6:0.2", "bounds of lam are contradictory"),
        ("--bounds lam=0.6", "two numbers with a colon"),
        ("--bounds Lam=0:1", "did you mean 'lam'"),
        ("--start lamda=0.4", "did you mean 'lam'"),
        ("--prior sigma=1:-0.1", "no positive spread"),
        ("--known K3=6000 --prior K3=1:0.1", "prior of K3: it is known here"),
        ("--per D=temperature", "has no attribute 'temperature'"),
        ("--loss hubber", "did you mean 'huber'"),
        ("--planes disk", "has 2 planes"),
        ("--planes disk,seal", "has planes disk, journal"),
        ("--blocks gyro", "did you mean 'gyroscopic'"),
        ("--probe-angles jurnal=45:135", "did you mean 'journal'"),
        ("--model whirl-wip", "did you mean 'whirl-whip'"),
        ("--model one-mode", "the model one-mode has journal"),
        ("--model overhung --two-lam", "has no option two_lam"),
    ],
)
def test_bad_settings_are_one_sentence(run: Run, tmp_path: Path, words: str, expected: str) -> None:
    given = ["fit", RIG, "--model", "whirl-whip", *words.split(), "--out", str(tmp_path / "out")]
    assert expected in refused(run(*given))
    assert list(tmp_path.iterdir()) == []


HEAD = "run,speed_rpm,frequency_rpm,force_plane,force_N,force_phase_deg,plane,direction,amplitude_um,phase_deg\n"
ROW = "a,1000,{},journal,0.1,0,journal,z,12.5,-30\n"


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("empty.csv", "", "empty"),
        ("head.csv", HEAD, "no"),
        ("one.csv", HEAD + ROW.format(500), "too few to estimate its noise"),
        ("missing.csv", HEAD.replace(",phase_deg\n", "\n") + "a,1000,500,journal,0.1,0,journal,z,12.5\n", "phase_deg"),
        ("unit.csv", HEAD.replace("amplitude_um", "amplitude_inches") + ROW.format(500), "amplitude_inches"),
        ("nan.csv", HEAD + ROW.format("nan"), "finite"),
        ("words.csv", HEAD + ROW.format("fast"), "'fast' is not a number"),
        ("binary.csv", "\x00\x01\x02", "binary.csv"),
        ("rig.xls", "PK", "a spreadsheet (.xls), which is not read"),
        ("rig.xlsx", "PK", "not a readable Excel file"),
    ],
)
def test_bad_files_are_one_sentence(run: Run, tmp_path: Path, name: str, text: str, expected: str) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    for words in (["fit", tmp_path / name, "--model", "one-mode", "--known", "K=0,Ds=0", "--out", tmp_path / "out"],
                  ["info", tmp_path / name]):  # fmt: skip
        if words[0] == "info" and name == "one.csv":
            continue  # a file of one line can be described, only not fitted
        message = refused(run(*words))
        assert expected in message
        assert name in message or name == "one.csv"  # that one is told by run and channel
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_missing_file_and_bad_folder(run: Run, tmp_path: Path) -> None:
    assert "absent.csv" in refused(run("info", tmp_path / "absent.csv"))
    (tmp_path / "file").write_text("kept", encoding="utf-8")
    message = refused(run(*FIT, "--out", tmp_path / "file"))
    assert "is a file; give a folder" in message
    assert (tmp_path / "file").read_text(encoding="utf-8") == "kept"


def test_a_file_of_the_users_own_is_not_replaced(run: Run, tmp_path: Path) -> None:
    (tmp_path / "summary.txt").write_text("mine", encoding="utf-8")
    assert "summary.txt exists and is no result" in refused(run(*FIT, "--no-figures", "--quiet", "--out", tmp_path))
    assert [file.name for file in tmp_path.iterdir()] == ["summary.txt"]
    assert (tmp_path / "summary.txt").read_text(encoding="utf-8") == "mine"


def test_a_bug_is_not_hidden_as_bad_input(run: Run, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def broken(*_: object) -> None:
        raise KeyError("bug")

    monkeypatch.setattr("rotorfit.apps.study_files.results.summary", broken)
    assert run(*FIT, "--out", tmp_path / "out")[0] == 4
    assert list(tmp_path.iterdir()) == []


def test_folder_below_a_file(run: Run, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("kept", encoding="utf-8")
    message = refused(run(*FIT, "--out", tmp_path / "file" / "results" / "today"))
    assert message == f"{tmp_path / 'file'} is a file; give a folder for the results"
    assert [p.name for p in tmp_path.iterdir()] == ["file"]


def test_folder_without_permission(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(folder: Path) -> None:
        raise PermissionError(13, "Permission denied", str(folder))

    monkeypatch.setattr(Path, "mkdir", forbidden)  # root may write everywhere
    assert refused(run(*FIT, "--out", tmp_path / "out")) == (
        f"cannot write to {tmp_path}: Permission denied; give another folder"
    )
    assert list(tmp_path.iterdir()) == []


# ---- README and the first tutorial ---------------------------------------------------------------


FIRST_TUTORIAL = "docs/tutorials/your_file.md"


def blocks(page: str, language: str) -> list[str]:
    text = (ROOT / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def test_accuracy_on_the_page_is_what_the_demo_prints(demo: tuple[Path, str]) -> None:
    (shown,) = [block for block in blocks("docs/theory/numbers.md", "text") if "against the rig's truth" in block]
    printed = demo[1]
    printed = printed[printed.index("against the rig's truth") :].partition("\n\n")[0]
    assert len(shown.split()) == len(printed.split())
    for old, new in zip(shown.split(), printed.split(), strict=True):
        if re.fullmatch(r"[0-9.]+", old):
            last_digit = 10.0 ** -len(old.partition(".")[2])
            assert float(new) == pytest.approx(float(old), abs=1.01 * last_digit)  # another machine may round over
        else:
            assert new == old


def test_commands_of_the_readme_and_of_the_first_tutorial_run(
    run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.csv").write_bytes(Path(RIG).read_bytes())
    (tmp_path / "rk4_sync.csv").write_bytes(Path(rotorfit.datasets.path("rk4_sync.csv")).read_bytes())
    (study,) = blocks(FIRST_TUTORIAL, "toml")
    (tmp_path / "study.toml").write_text(study, encoding="utf-8")
    lines = "".join(blocks("README.md", "sh") + blocks(FIRST_TUTORIAL, "sh")).splitlines()
    commands = [line.split()[1:] for line in dict.fromkeys(lines) if line.startswith("rotorfit ")]
    assert {words[0] for words in commands} >= {"info", "models", "fit", "run"}
    for name in ("disk-fwd", "journal-fwd"):
        recording = Path(rotorfit.datasets.path(f"volts_{name}.h5"))
        (tmp_path / f"{name}.h5").write_bytes(recording.read_bytes())
    for words in commands:
        redirected = words[-2] == ">"
        code, out, err = run(*(words[:-2] if redirected else words))
        assert (code, err) == (0, ""), words
        if redirected:
            (tmp_path / words[-1]).write_text(out, encoding="utf-8")


# ---- around the work --------------------------------------------------------------------------


def test_the_bare_command_prints_help(run: Run) -> None:
    code, out, _ = run()
    assert code == 0
    assert out.startswith("usage: rotorfit")
    assert "demo" in out


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_a_shell_can_be_taught_the_words(run: Run, shell: str) -> None:
    code, out, _ = run("completion", shell)
    assert code == 0
    for word in ("--phase-offsets", "simulate", "--figure-format"):
        assert word in out


def test_completion_without_its_library_says_what_to_install(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "shtab", None)
    code, _, err = run("completion", "bash")
    assert code == cli.ExitCode.BAD_INPUT
    assert 'pip install "rotorfit[completion]"' in err


def test_time_left_is_told_and_the_bar_is_full_only_at_the_end(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = iter([0.0, 0.0, 0.0, 0.0, 10.0, 10.0, 30.0, 30.0])
    monkeypatch.setattr("rotorfit.apps.cli.answer.monotonic", lambda: next(clock))
    line = ProgressLine(enabled=True)
    line("sampling", 0.0)
    line("sampling", 0.25)  # a quarter in 10 s: 30 s more
    line("sampling", 0.75)
    shown = capsys.readouterr().err.split("\r\033[K")[1:]
    assert [text.partition("...")[2].strip() for text in shown] == ["", "about 30 s left", "about 10 s left"]


def test_sampling_counts_no_further_than_it_has_to(tmp_path: Path) -> None:
    """The bar stood at 100 % while the autocorrelation time was not resolved, and counted 4285 of 1000 samples."""
    import rotorfit as rf
    from rotorfit.estimators.inference.ensemble_sampler import RESOLVED_TIMES

    states = []
    fit = rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0})
    fit.sample(seed=1, ess=50, progress=states.append)
    assert states[-1].done == 1.0
    assert all(0 <= state.done < 1 for state in states[:-1])
    for state in states:
        assert float(state.waiting.split()[0]) <= max(50, RESOLVED_TIMES * state.tau + 1)


def test_an_output_that_is_closed_full_or_of_few_letters_is_no_traceback(tmp_path):
    """Names cannot steer the terminal either."""
    names = {"disk": "Scheibe \u00fc", "journal": "\x1b[31mred"}
    text = Path(RIG).read_text(encoding="utf-8")
    for name, other in names.items():
        text = text.replace(f",{name},", f",{other},")
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    program = f"{sys.executable} -m rotorfit"
    info = f"{program} info {tmp_path / 'a.csv'}"
    for script, code, words in (
        (f"PYTHONIOENCODING=ascii {info}", 0, b"measured at"),
        (f"{info} >&-", 2, b"Bad file descriptor"),
        (f"{info} > /dev/full", 2, b"No space left on device"),
        (f"{program} --help > /dev/full", 2, b"No space left on device"),
        (f"{program} --help >&- 2>&-", 2, b""),
    ):
        done = subprocess.run(["bash", "-c", script], capture_output=True, check=False)
        said = done.stdout + done.stderr
        assert done.returncode == code, said
        assert words in said
        assert b"Traceback" not in said
        assert b"ignored" not in said
        assert b"\x1b" not in said


def test_an_interactive_report_without_bokeh_is_refused_before_the_fit(
    rig_fit: FitResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["fit", str(datasets.path("rig_lumped.csv")), "--model", "whirl-whip", "--interactive"]
    assert cli.main(words) == 2
    hear(capsys.readouterr().err)
    monkeypatch.setattr(interactive, "find_spec", lambda name: None)
    assert cli.main([*words, "--out", str(tmp_path / "results")]) == 2
    assert 'pip install "rotorfit[interactive]"' in capsys.readouterr().err
    with refuses(ValueError):
        rf.write_report(rig_fit, tmp_path / "report.html", interactive=True)
    assert list(tmp_path.iterdir()) == []


def test_info_of_a_clean_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["info", str(rf.datasets.path("rig_open.csv"))]) == 0
    printed = capsys.readouterr().out
    assert "[" not in printed
    assert "disk, journal" in printed
