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

import rotorfit as rf
from rotorfit.cli import main as cli
from rotorfit.data.experiments import PerturbationTest
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
    ("change", "message"),
    [
        (spoilt("response", 3, np.nan), r"rig_open\.csv: 1 readings are not finite \(rows 4\); remove them"),
        (spoilt("force", 3, np.inf), r"1 readings are not finite \(rows 4\)"),
        (spoilt("frequency", 5, np.nan), r"1 readings are not finite \(rows 6\)"),
        (spoilt("speed", 0, np.nan), r"1 readings are not finite \(rows 1\)"),
        (spoilt("sigma", 7, -1e-7), r"the noise sigma must be positive and finite, or NaN if unknown \(rows 8\)"),
        (spoilt("sigma", 7, np.inf), r"the noise sigma must be positive and finite"),
        (spoilt("force", slice(None), 0.0), "every force is zero"),
        (dead_probe, "every reading of journal y is zero: a probe that was not connected"),
        (lambda t: t.select(np.zeros(len(t), dtype=bool)), "give at least one experiment with at least one reading"),
        (lambda t: t.select([0, 1]), "10 unknowns but only 2 real data: fix parameters or add readings"),
        (other_rig, r"other\.csv has planes rotor, seal .* has disk, journal\. Map names \(planes="),
    ],
)
def test_data_that_cannot_be_fitted(
    rig: PerturbationTest, change: Callable[[PerturbationTest], PerturbationTest], message: str
) -> None:
    test = change(rig)
    for identify in (rf.fit, rf.closed_form):
        with pytest.raises(ValueError, match=message) as error:
            identify(WhirlWhip(), test, known=K3)
        assert is_sentence(str(error.value))


def test_rigs_that_are_not_one(rig: PerturbationTest) -> None:
    with pytest.raises(ValueError, match=r"other\.csv has planes rotor, seal"):
        rf.fit(WhirlWhip(), [rig, other_rig(rig)], known=K3)
    with pytest.raises(ValueError, match="give at least one experiment"):
        rf.fit(WhirlWhip(), [])


def test_singular_response_matrices(rig: PerturbationTest) -> None:
    """Forces at either plane that move both in proportion: eq. (7) has no inverse at any frequency."""
    flat = replace(rig, response=(np.abs(rig.force) * np.where(rig.plane == "disk", 1e-6, 2e-6)).astype(complex))
    with pytest.raises(ValueError, match="common frequencies are singular") as error:
        rf.dynamic_stiffness(flat.select(flat.direction == "x"))
    assert is_sentence(str(error.value))
    shifted = replace(rig, frequency=rig.frequency * np.where(rig.force_plane == "disk", 1.0, 1.01))
    with pytest.raises(ValueError, match="the runs have no frequency in common"):
        rf.dynamic_stiffness(shifted)
    with pytest.raises(ValueError, match="no force at disk"):
        rf.dynamic_stiffness(rig.select(rig.force_plane == "journal"))
    with pytest.raises(ValueError, match="no readings at planes seal"):
        rf.dynamic_stiffness(rig, ["seal"])


def test_a_few_singular_lines_are_left_out(rig: PerturbationTest) -> None:
    line = np.abs(rig.frequency - rig.frequency[40]) < 1e-9
    spoiled = replace(rig, response=np.where(line, rig.force * 1e-6, rig.response))
    whole, fewer = rf.dynamic_stiffness(rig), rf.dynamic_stiffness(spoiled)
    assert whole.frequency.size - fewer.frequency.size == 1


# ---- the Python interface: settings ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "kind", "message"),
    [
        ({"known": {"k3": 6000.0}}, KeyError, "unknown parameter of whirl-whip 'k3', did you mean 'K3'"),
        ({"bounds": {"lamda": (0, 1)}}, KeyError, "'lamda', did you mean 'lam'"),
        ({"start": {"lamm": 0.4}}, KeyError, "'lamm', did you mean 'lam'"),
        ({"priors": {"lm": stats.norm(0.5, 0.1)}}, KeyError, "'lm', did you mean 'lam'"),
        ({"per": {"Dx": "speed_rpm"}}, KeyError, "'Dx', did you mean 'D'"),
        ({"per": {"D": "oil_C"}}, KeyError, "no attribute 'oil_C'; it has run, speed_rpm"),
        ({"loss": "hubber"}, ValueError, "unknown loss 'hubber', did you mean 'huber'"),
        ({"bounds": {"lam": (1, 0)}}, ValueError, "bounds of lam are contradictory: lower 1 is not below upper 0"),
        ({"bounds": {"lam": (0.4, 0.4)}}, ValueError, "bounds of lam are contradictory"),
        ({"bounds": {"lam": (np.nan, 0.4)}}, ValueError, "bounds of lam are contradictory"),
        ({"bounds": {"Md": (-2.0, -1.0)}}, ValueError, r"bounds of Md are contradictory.*physical limits \[0, inf\]"),
        ({"bounds": {"lam": 0.4}}, ValueError, "bounds of lam must be two numbers, lower and upper"),
        ({"bounds": {"lam": ("low", "high")}}, ValueError, "bounds of lam must be two numbers"),
        ({"bounds": {"K3": (0.0, 1.0)}}, ValueError, r"known K3 = 6000 N/m is outside its bounds \[0, 1\]"),
        ({"known": {"Md": -1.0}}, ValueError, r"known Md = -1 kg is outside the physical limits \[0, inf\]"),
        ({"known": {"K3": np.nan}}, ValueError, "known K3 = nan is not a finite number"),
        ({"known": {"K3": "stiff"}}, ValueError, "known K3 = 'stiff' is not a finite number"),
        ({"start": {"lam": 0.9}, "bounds": {"lam": (0, 0.5)}}, ValueError, r"start lam = 0.9 is not .* \[0, 0.5\]"),
        ({"start": {"lam": np.nan}}, ValueError, "start lam = nan is not a finite number"),
        ({"start": {"K3": 5000.0}}, KeyError, "unknown fitted parameter 'K3'"),
        ({"priors": {"lam": (0.4, 0.1)}}, ValueError, "prior of lam must be a frozen scipy.stats distribution"),
        ({"priors": {"lam": stats.norm(0.4, 0.0)}}, ValueError, "prior of lam needs .* positive, finite standard"),
        ({"priors": {"lam": stats.cauchy(0.4, 0.1)}}, ValueError, "prior of lam needs a finite mean"),
        ({"priors": {"lam": stats.uniform(2, 1)}, "bounds": {"lam": (0, 1)}}, ValueError, "nothing is left"),
        ({"priors": {"K3": stats.norm(1, 0.1)}}, ValueError, "prior of K3: it is known here"),
        ({"per": {"K3": "speed_rpm"}}, ValueError, "K3 is both known and fitted per attribute"),
        ({"known": dict.fromkeys(WhirlWhip().parameter_names, 1.0)}, ValueError, "every parameter is known"),
    ],
)
def test_settings_that_cannot_be_meant(
    rig: PerturbationTest, options: dict[str, Any], kind: type[Exception], message: str
) -> None:
    with pytest.raises(kind, match=message) as error:
        rf.fit(WhirlWhip(), rig, **{"known": K3, **options})
    if not isinstance(options.get("known", {}).get("K3"), str):
        assert is_sentence(str(error.value.args[0]))


@pytest.mark.parametrize(
    ("model", "experiment", "message"),
    [
        ("whirl-whip", None, "the model must be an instance such as rf.models.WhirlWhip"),
        (WhirlWhip, None, "the model must be an instance such as rf.models.WhirlWhip"),
        (WhirlWhip(), "rig.csv", r"not the name of a file: rf\.read\('rig\.csv'\)"),
        (WhirlWhip(), Path("rig.csv"), r"not the name of a file: rf\.read\('rig\.csv'\)"),
        (WhirlWhip(), np.ones(3), "experiments such as rf.read returns, not ndarray"),
        (WhirlWhip(), ["rig.csv"], "experiments such as rf.read returns, not str"),
    ],
)
def test_things_in_the_wrong_place(rig: PerturbationTest, model: Any, experiment: Any, message: str) -> None:
    with pytest.raises(TypeError, match=message):
        rf.fit(model, rig if experiment is None else experiment)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: WhirlWhip(planes=("disk", "journal", "seal")), "whirl-whip has 2 planes, each with a name of its own"),
        (lambda: WhirlWhip(planes=("disk", "disk")), "each with a name of its own"),
        (lambda: WhirlWhip(blocks=("gyro",)), "unknown structural block 'gyro', did you mean 'gyroscopic'"),
        (lambda: rf.datasets.path("rig_opn.csv"), r"unknown data set 'rig_opn\.csv', did you mean 'rig_open\.csv'"),
    ],
)
def test_names_are_suggested(make: Callable[[], Any], message: str) -> None:
    with pytest.raises((ValueError, OSError), match=message):
        make()


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"direction": "q"}, r"direction \['q'\] unknown; allowed: x, y, z"),
        ({"run": ["a", "b", "c"], "frequency": [1.0, 2.0]}, "lists of one length; got run 3, frequency 2"),
        ({"frequency": [[1.0, 2.0]]}, "lists of one length; got frequency 1 x 2"),
        ({"speed": "fast"}, "speed must be numbers in SI units"),
    ],
)
def test_arrays_that_make_no_test(columns: dict[str, Any], message: str) -> None:
    good: dict[str, Any] = {
        "run": "a", "speed": 100.0, "frequency": 20.0, "force_plane": "p", "force": 1.0, "plane": "p",
        "direction": "x", "response": 1e-6,
    }  # fmt: skip
    with pytest.raises(ValueError, match=message):
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
        ("info rig.csv --probe-angles journal=45:135", "no partner"),
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
        ("fit rig.csv --model two-disk --known K1=1", "Map names (planes=, --planes)"),
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
