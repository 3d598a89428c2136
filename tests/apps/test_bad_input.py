"""Whatever is wrong with what the user gives, one sentence says what, where and what to do; nothing is left behind."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import stats
from sentences import refuses

import rotorfit as rf
from rotorfit.apps.cli import main as cli
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.models import OneMode, WhirlWhip

K3 = {"K3": 6000.0}
HEADER = "run,speed_rpm,frequency_rpm,force_plane,force_N,force_phase_deg,plane,direction,amplitude_um,phase_deg"
ROW = "a,1000,300,journal,2.5,30,journal,x,12,-40"


@pytest.fixture(scope="module")
def rig() -> PerturbationTest:
    test = rf.datasets.rig_open()
    assert isinstance(test, PerturbationTest)
    return test.select(test.speed < 110)


def is_sentence(message: str) -> bool:
    """Several words on one line, without remains of Python."""
    remains = ("Traceback", "<class", "object at 0x", "numpy.", "np.")
    return len(message.split()) >= 5 and "\n" not in message and not any(word in message for word in remains)


# ---- the Python interface: data ----------------------------------------------------------------------------


def spoilt(column: str, row: int | slice, value: Any) -> Callable[[PerturbationTest], PerturbationTest]:
    def change(test: PerturbationTest) -> PerturbationTest:
        values = getattr(test, column).copy()
        values[row] = value
        changed: dict[str, Any] = {column: values}
        return replace(test, **changed)

    return change


def other_rig(test: PerturbationTest) -> PerturbationTest:
    names = {"disk": "rotor", "journal": "seal"}
    planes: dict[str, Any] = {
        name: np.array([names[p] for p in getattr(test, name).tolist()]) for name in ("plane", "force_plane")
    }
    return replace(test, **planes, source="other.csv")


def dead_probe(test: PerturbationTest) -> PerturbationTest:
    dead = (test.plane == "journal") & (test.direction == "y")
    return replace(test, response=np.where(dead, 0.0, test.response))


@pytest.mark.parametrize(
    "change",
    [
        spoilt("response", 3, np.nan),
        spoilt("force", 3, np.inf),
        spoilt("frequency", 5, np.nan),
        spoilt("speed", 0, np.nan),
        spoilt("sigma", 7, -1e-7),
        spoilt("sigma", 7, np.inf),
        spoilt("force", slice(None), 0.0),
        dead_probe,
        lambda t: t.select(np.zeros(len(t), dtype=bool)),
        lambda t: t.select([0, 1]),
        other_rig,
    ],
)
def test_data_that_cannot_be_fitted(
    rig: PerturbationTest, change: Callable[[PerturbationTest], PerturbationTest]
) -> None:
    test = change(rig)
    for identify in (rf.fit, rf.closed_form):
        with refuses(ValueError) as error:
            identify(WhirlWhip(), test, known=K3)
        assert is_sentence(str(error.value))


def test_rigs_that_are_not_one(rig: PerturbationTest) -> None:
    with refuses(ValueError):
        rf.fit(WhirlWhip(), [rig, other_rig(rig)], known=K3)
    with refuses(ValueError):
        rf.fit(WhirlWhip(), [])


def test_singular_response_matrices(rig: PerturbationTest) -> None:
    """Forces at either plane that move both in proportion: eq. (7) has no inverse at any frequency."""
    flat = replace(rig, response=(np.abs(rig.force) * np.where(rig.plane == "disk", 1e-6, 2e-6)).astype(complex))
    with refuses(ValueError) as error:
        rf.dynamic_stiffness(flat.select(flat.direction == "x"))
    assert is_sentence(str(error.value))
    shifted = replace(rig, frequency=rig.frequency * np.where(rig.force_plane == "disk", 1.0, 1.01))
    with refuses(ValueError):
        rf.dynamic_stiffness(shifted)
    with refuses(ValueError):
        rf.dynamic_stiffness(rig.select(rig.force_plane == "journal"))
    with refuses(ValueError):
        rf.dynamic_stiffness(rig, ["seal"])


def test_a_few_singular_lines_are_left_out(rig: PerturbationTest) -> None:
    line = np.abs(rig.frequency - rig.frequency[40]) < 1e-9
    spoiled = replace(rig, response=np.where(line, rig.force * 1e-6, rig.response))
    whole, fewer = rf.dynamic_stiffness(rig), rf.dynamic_stiffness(spoiled)
    assert whole.frequency.size - fewer.frequency.size == 1


# ---- the Python interface: settings ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "kind"),
    [
        ({"known": {"k3": 6000.0}}, KeyError),
        ({"bounds": {"lamda": (0, 1)}}, KeyError),
        ({"start": {"lamm": 0.4}}, KeyError),
        ({"priors": {"lm": stats.norm(0.5, 0.1)}}, KeyError),
        ({"per": {"Dx": "speed_rpm"}}, KeyError),
        ({"per": {"D": "oil_C"}}, KeyError),
        ({"loss": "hubber"}, ValueError),
        ({"bounds": {"lam": (1, 0)}}, ValueError),
        ({"bounds": {"lam": (0.4, 0.4)}}, ValueError),
        ({"bounds": {"lam": (np.nan, 0.4)}}, ValueError),
        ({"bounds": {"Md": (-2.0, -1.0)}}, ValueError),
        ({"bounds": {"lam": 0.4}}, ValueError),
        ({"bounds": {"lam": ("low", "high")}}, ValueError),
        ({"bounds": {"K3": (0.0, 1.0)}}, ValueError),
        ({"known": {"Md": -1.0}}, ValueError),
        ({"known": {"K3": np.nan}}, ValueError),
        ({"known": {"K3": "stiff"}}, ValueError),
        ({"start": {"lam": 0.9}, "bounds": {"lam": (0, 0.5)}}, ValueError),
        ({"start": {"lam": np.nan}}, ValueError),
        ({"start": {"K3": 5000.0}}, KeyError),
        ({"priors": {"lam": (0.4, 0.1)}}, ValueError),
        ({"priors": {"lam": stats.norm(0.4, 0.0)}}, ValueError),
        ({"priors": {"lam": stats.cauchy(0.4, 0.1)}}, ValueError),
        ({"priors": {"lam": stats.uniform(2, 1)}, "bounds": {"lam": (0, 1)}}, ValueError),
        ({"priors": {"K3": stats.norm(1, 0.1)}}, ValueError),
        ({"per": {"K3": "speed_rpm"}}, ValueError),
        ({"known": dict.fromkeys(WhirlWhip().parameter_names, 1.0)}, ValueError),
    ],
)
def test_settings_that_cannot_be_meant(rig: PerturbationTest, options: dict[str, Any], kind: type[Exception]) -> None:
    with refuses(kind) as error:
        rf.fit(WhirlWhip(), rig, **{"known": K3, **options})
    if not isinstance(options.get("known", {}).get("K3"), str):
        assert is_sentence(str(error.value.args[0]))


@pytest.mark.parametrize(
    ("model", "experiment"),
    [
        ("whirl-whip", None),
        (WhirlWhip, None),
        (WhirlWhip(), "rig.csv"),
        (WhirlWhip(), Path("rig.csv")),
        (WhirlWhip(), np.ones(3)),
        (WhirlWhip(), ["rig.csv"]),
    ],
)
def test_things_in_the_wrong_place(rig: PerturbationTest, model: Any, experiment: Any) -> None:
    with refuses(TypeError):
        rf.fit(model, rig if experiment is None else experiment)


@pytest.mark.parametrize(
    "make",
    [
        lambda: WhirlWhip(planes=("disk", "journal", "seal")),
        lambda: WhirlWhip(planes=("disk", "disk")),
        lambda: WhirlWhip(blocks=("gyro",)),
        lambda: rf.datasets.path("rig_opn.csv"),
    ],
)
def test_names_are_suggested(make: Callable[[], Any]) -> None:
    with refuses((ValueError, OSError)):
        make()


@pytest.mark.parametrize(
    "columns",
    [
        {"direction": "q"},
        {"run": ["a", "b", "c"], "frequency": [1.0, 2.0]},
        {"frequency": [[1.0, 2.0]]},
        {"speed": "fast"},
    ],
)
def test_arrays_that_make_no_test(columns: dict[str, Any]) -> None:
    good: dict[str, Any] = {
        "run": "a", "speed": 100.0, "frequency": 20.0, "force_plane": "p", "force": 1.0, "plane": "p",
        "direction": "x", "response": 1e-6,
    }  # fmt: skip
    with refuses(ValueError):
        rf.perturbation_test(**(good | columns))


# ---- files and the command line -----------------------------------------------------------------------------------


def sweep(**other: str) -> str:
    """A file of forty good lines, some columns replaced."""
    names = HEADER.split(",")
    lines = [HEADER]
    for i in range(40):
        cells = dict(zip(names, ROW.split(","), strict=True)) | {"frequency_rpm": str(50 * (i - 19.5))} | other
        lines.append(",".join(cells[name] for name in names))
    return "\n".join(lines) + "\n"


def others(force_plane: str, plane: str) -> str:
    """Rows of another plane."""
    return sweep(force_plane=force_plane, plane=plane).partition("\n")[2]


BAD_FILES = {
    "empty.csv": ("", "empty.csv is empty"),
    "blank.csv": ("\n\n# only a remark\n", "blank.csv is empty"),
    "header.csv": (HEADER + "\n", "has one line"),
    "one_line.csv": ("hello\n", "has one line, 'hello', and no rows below it"),
    "prose.csv": ("To whom it may concern\nhere are our data\n", "missing columns: run"),
    "typo.csv": (sweep().replace("frequency_rpm", "freqency_rpm"), "did you mean 'frequency_rpm'"),
    "unit.csv": (sweep().replace("amplitude_um", "amplitude_furlong"), "amplitude_furlong"),
    "no_speed.csv": ("\n".join(",".join(c for i, c in enumerate(line.split(",")) if i != 1)
                               for line in sweep().splitlines()), "missing columns: speed_rpm"),
    "blank_speed.csv": (sweep(speed_rpm=""), "line 2, column 'speed_rpm': a blank cell where a finite number"),
    "nan.csv": (sweep(amplitude_um="nan"), "line 2, column 'amplitude_um': nan where a finite number is needed"),
    "inf.csv": (sweep(force_N="inf"), "line 2, column 'force_N': inf where a finite number is needed"),
    "comma.csv": (sweep(phase_deg="\"-40,5x\""), "'-40,5x' is not a number"),
    "negative.csv": (sweep(amplitude_um="-12"), "-12 is negative; amplitudes are not"),
    "direction.csv": (sweep(direction="w"), "unknown direction 'w'"),
    "short.csv": (sweep() + "a,1000,300\n", "line 42 has 3 cells, the header has 10 columns"),
    "twice.csv": (sweep().replace("force_phase_deg", "speed_hz"), "speed is given twice, as speed_rpm and speed_hz"),
    "zero.csv": (sweep(force_N="0"), "every force is zero"),
    "dead.csv": (sweep(amplitude_um="0"), "every reading of journal x is zero"),
    "two_rigs.csv": (sweep() + others("seal", "seal"), "has planes journal, seal"),
    "mixed.csv": (sweep() + others("seal", "seal") + others("disk", "journal"), "no run connects these"),
}  # fmt: skip


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run the command line and return the one sentence of its refusal."""

    def call(*words: str | Path) -> str:
        assert cli.main([str(word) for word in words]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        assert err.startswith("rotorfit: ")
        assert len(err.splitlines()) == 1
        assert is_sentence(err.rstrip("\n"))
        return err

    return call


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files_leave_nothing_behind(run: Callable[..., str], tmp_path: Path, name: str) -> None:
    text, message = BAD_FILES[name]
    (tmp_path / name).write_text(text, encoding="utf-8")
    err = run("fit", tmp_path / name, "--model", "one-mode", "--known", "K=0,Ds=0", "--out", tmp_path / "out")
    assert message in err
    assert name in err
    assert [p.name for p in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("suffix", [".csv", ".uff", ".nc", ".mat"])
@pytest.mark.parametrize("content", [b"", b"\x89PNG\r\n\x1a\n\x00\x00", bytes(range(256)) * 20])
def test_binary_junk(run: Callable[..., str], tmp_path: Path, suffix: str, content: bytes) -> None:
    (tmp_path / f"junk{suffix}").write_bytes(content)
    assert f"junk{suffix}" in run("info", tmp_path / f"junk{suffix}")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("fit absent.csv --model one-mode", "absent.csv: No such file or directory"),
        ("fit rig.csv --model one-mod", "unknown model 'one-mod', did you mean 'one-mode'"),
        ("fit rig.csv --model one-mode --known k0=3", "'k0', did you mean 'K0'"),
        ("fit rig.csv --model one-mode --known K=0,Ds=0 --bounds lam=0.6:0.2", "bounds of lam are contradictory"),
        ("fit rig.csv --model one-mode --known K=0,Ds=0,lam=0.4 --bounds lam=0.5:1", "outside its bounds [0.5, 1]"),
        (
            "fit rig.csv --model one-mode --known K=0,Ds=0 --start lam=3",
            "start lam = 3.0 is not a finite number within",
        ),
        ("fit rig.csv --model one-mode --known K=0,Ds=0 --prior lam=5:0.1 --bounds lam=0:1 --loss hubr", "'huber'"),
        ("fit rig.csv --model two-disk", "rig.csv has planes journal"),
        ("fit rig.csv --model one-mode --speed 1000", "speed is an option of universal files"),
        ("fit rig.csv --model one-mode --slow-roll-below 300", "slow roll can only be taken"),
        ("info rig.csv --probe-angles journal=45:135", "without a partner"),
        ("models one-mod", "did you mean 'one-mode'"),
        ("fit rig.csv --model one-mode --drop-near-1x 500", "--drop-near-1x is per cent of the speed, from 0"),
        (
            "fit rig.csv --model one-mode --windows 24",
            "--windows is for recordings of raw signals, which rig.csv is not",
        ),
        (
            "fit rig.csv --model one-mode --law muszynska",
            "radial clearance in micrometres (clearance_um=, --clearance-um)",
        ),
        ("fit rig.csv --model two-disk --known K1=1", "map names (planes=, --planes)"),
        (
            "fit two.csv --model one-mode --known K=0,Ds=0",
            "(where=, --where plane=A --where force_plane=A)",
        ),
        ("fit rig.csv --model one-mode --known K=0,Ds=0 --calibration probe_gain=2", "below 0.5 (as a fraction, 0.02"),
        ("fit rig.csv --model one-mode --known K=0,Ds=0,lam=3", "known lam = 3 is outside the physical limits [-2, 2]"),
        ("info rig.csv --probe-angles journal=0:0", "probe angles: probes at 0.0 and 0.0 degrees"),
        ("look rig.csv", "rig.csv is a table of vectors, not of raw signals: rf.read, `rotorfit info`"),
        ("run absent.toml", "absent.toml: No such file or directory"),
        ("run windows.toml", "byte 0 is not; save it as UTF-8"),
        ("run law.toml", "radial clearance in micrometres (clearance_um=, --clearance-um)"),
        ("run study.toml", "unknown key 'modell', did you mean 'model'"),
    ],
)
def test_bad_words(
    run: Callable[..., str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: str, message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("rig.csv").write_text(sweep(), encoding="utf-8")
    Path("two.csv").write_text(sweep() + others("journal", "seal"), encoding="utf-8")
    Path("windows.toml").write_bytes(b'\xf6 = "one-mode"')
    Path("law.toml").write_bytes(b'\xef\xbb\xbffiles = ["rig.csv"]\nmodel = "one-mode"\nlaw = "muszynska"\n')
    Path("study.toml").write_text('files = ["rig.csv"]\nmodell = "one-mode"\n', encoding="utf-8")
    assert message in run(*words.split(), *(["--out", "out"] if words.startswith(("fit", "run")) else []))
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "law.toml",
        "rig.csv",
        "study.toml",
        "two.csv",
        "windows.toml",
    ]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            "fit --model one-mode",
            "the following arguments are required: FILE; `rotorfit fit --help` says what there is",
        ),
        ("fit rig.csv --model one-mode --seed -1", "argument --seed:"),
        ("campaign study.toml --jobs 0", "argument --jobs: at least 1 is needed"),
        ("trend a.csv --false-alarm 2", "argument --false-alarm: 2 is no probability, which is below 1"),
        ("look a.h5 --clearance-um -3", "argument --clearance-um: -3 is not above zero"),
        ("fitt rig.csv", "invalid choice: 'fitt'"),
    ],
)
def test_words_that_the_command_line_does_not_know(
    capsys: pytest.CaptureFixture[str], words: str, message: str
) -> None:
    with pytest.raises(SystemExit) as stop:
        cli.main(words.split())
    assert stop.value.code == 2
    err = capsys.readouterr().err
    assert err.startswith("rotorfit: ")
    assert len(err.splitlines()) == 1
    assert message in err


def test_the_program_itself_exits_with_two(tmp_path: Path) -> None:
    (tmp_path / "empty.csv").touch()
    words = [sys.executable, "-m", "rotorfit", "info", str(tmp_path / "empty.csv")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr.startswith("rotorfit: empty.csv is empty")
    assert "Traceback" not in done.stderr


# ---- any text at all ------------------------------------------------------------------------------------------------

cells = st.one_of(
    st.text(st.characters(codec="utf-8"), max_size=6),
    st.sampled_from(
        ["a", "x", "y", "z", "rx", "journal", "1e999", "-1e999", "nan", "1,5", "#", '"', "", " ", "0", "-0"]
    ),
    st.floats().map(str),
    st.integers(-(10**30), 10**30).map(str),
)
columns = st.sampled_from(
    [*HEADER.split(","), "sigma_um", "mr_g_mm", "real_um", "imag_um", "probe_radius_mm", "force_x_N", "load_N", "x_um",
     "damping_ratio", "eccentricity_ratio", "time_s", "kxx", "oil_C", "amplitude_furlong"]
)  # fmt: skip


@st.composite
def tables(draw: st.DrawFn) -> str:
    """A table that is nearly right: the columns of a test, some others, and rows with a few odd cells."""
    header = draw(st.one_of(st.just(HEADER.split(",")), st.lists(columns, max_size=14)))
    good = dict(zip(HEADER.split(","), ROW.split(","), strict=True))
    rows = []
    for _ in range(draw(st.integers(0, 5))):
        odd = draw(st.dictionaries(st.integers(0, 13), cells, max_size=3))
        rows.append([odd.get(i, good.get(name, "1")) for i, name in enumerate(header)])
    ending = draw(st.sampled_from(["\n", "\r\n", "\r"]))
    return ending.join(draw(st.sampled_from([",", ";", "\t"])).join(row) for row in [header, *rows])


def refusal(work: Callable[[], Any]) -> str:
    """Message of the ValueError that work ends with, or nothing; any other exception goes through."""
    try:
        work()
    except ValueError as error:
        return str(error)
    return ""


@pytest.mark.filterwarnings("ignore:.*readings are empty")
@pytest.mark.filterwarnings("ignore::rotorfit.DataWarning")
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(text=st.one_of(tables(), st.text(st.characters(codec="utf-8"), max_size=300)))
def test_any_text_is_a_test_or_is_refused_in_a_sentence(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.getbasetemp() / "t.csv"
    path.write_bytes(text.encode("utf-8"))
    message = refusal(lambda: rf.check(rf.read(path)))
    assert not message or (message.startswith("t.csv") and len(message.split()) >= 5)


@pytest.mark.filterwarnings("ignore:.*readings are empty")
@pytest.mark.filterwarnings("ignore::rotorfit.DataWarning")
@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(text=tables())
def test_any_table_is_solved_or_refused_in_a_sentence(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.getbasetemp() / "t.csv"
    path.write_bytes(text.encode("utf-8"))
    model, known = OneMode(), {"K": 0.0, "Ds": 0.0, "M": 1.0}
    message = refusal(lambda: rf.closed_form(model, rf.read(path), known=known))
    assert not message or len(message.split()) >= 5
