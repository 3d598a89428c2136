"""Tests along one axis at rest, sensors of acceleration and velocity, and noise that the coherence tells."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from linear_tests import linear_test
from plain import plain_fit
from sentences import refuses, warns
from synthetic import MODELS, TYPICAL, known_of

import rotorfit as rf
from rotorfit.base.array_types import ComplexArray, Float
from rotorfit.lab.data.experiments import PerturbationTest

HZ = np.linspace(4.0, 80.0, 120)
W = 2 * np.pi * HZ
TRUTH = TYPICAL["whirl-whip"]
KNOWN = known_of("whirl-whip", TRUTH) | {"lam": TRUTH["lam"], "Mf": TRUTH["Mf"]}
STANDARD_GRAVITY = 9.80665


def at_rest(noise: float = 0.0, seed: int = 0, along: str = "x") -> PerturbationTest:
    """Both planes forced along an axis in turn at standstill, by the equation of motion in real coordinates."""
    model = MODELS["whirl-whip"]()
    test = linear_test(
        model, model.vector(TRUTH), speed=0.0, frequency=W, along=along, noise=noise, seed=seed, force=5.0
    )
    return test.select(test.direction == along)


@pytest.mark.parametrize("along", ["x", "y"])
def test_one_direction_at_rest_gives_back_its_rig(along: str) -> None:
    fit = plain_fit(MODELS["whirl-whip"](), at_rest(along=along), known=KNOWN)
    for key in ("Md", "Ds", "K1", "K2", "Mb", "K0", "D"):
        assert fit.params[key].value == pytest.approx(TRUTH[key], rel=1e-6), key


def test_beside_pairs_single_probes_count_too() -> None:
    model = MODELS["whirl-whip"]()
    both = linear_test(model, model.vector(TRUTH), speed=0.0, frequency=W, along="x", force=5.0, noise=0.01)
    mixed = both.select((both.direction == "x") | (both.plane == "disk"))
    found = plain_fit(model, mixed, known=KNOWN).params["D"]
    assert abs(found.value - TRUTH["D"]) < 4 * found.stderr


def test_a_rotor_that_turns_or_a_reading_across_the_force_is_refused() -> None:
    model = MODELS["whirl-whip"]()
    turning = linear_test(model, model.vector(TRUTH), speed=100.0, frequency=W, along="x", force=5.0)
    with refuses(ValueError):
        plain_fit(model, turning.select(turning.direction == "x"), known=KNOWN)
    still = linear_test(model, model.vector(TRUTH), speed=0.0, frequency=W, along="x", force=5.0, noise=0.01)
    with refuses(ValueError):
        plain_fit(model, still.select(still.direction == "y"), known=KNOWN)


def test_lag_read_as_lead_is_named_at_rest_too() -> None:
    """A passive rig that took up no power would have negative damping."""
    table, _ = accelerations(5e-4, 1)
    assert rf.check(rf.read(table)) == []
    with warns(rf.DataWarning):
        rf.read(table.assign(phase_deg=-table.phase_deg))


def accelerations(sigma: float, seed: int) -> tuple[pd.DataFrame, ComplexArray]:
    """The table that an analyser would export, accelerometers in g with noise of the same size on all lines."""
    test, rng = at_rest(), np.random.default_rng(seed)
    a = -(test.frequency**2) * test.response / STANDARD_GRAVITY
    a = a + sigma * (rng.standard_normal(a.size) + 1j * rng.standard_normal(a.size))
    columns: Mapping[str, object] = {
        "run": test.run,
        "speed_rpm": 0.0,
        "frequency_hz": test.frequency / (2 * np.pi),
        "force_plane": test.force_plane,
        "force_N": 5.0,
        "force_phase_deg": 0.0,
        "force_direction": "x",
        "plane": test.plane,
        "direction": "x",
        "acceleration_g": np.abs(a),
        "phase_deg": np.degrees(np.angle(a)),
    }
    return pd.DataFrame(columns), a


def test_accelerations_are_displacements_with_their_noise_over_w_squared() -> None:
    table, a = accelerations(1e-3, 0)
    test = rf.read(table.assign(sigma_g=1e-3))
    assert isinstance(test, PerturbationTest)
    np.testing.assert_allclose(test.response, -a * STANDARD_GRAVITY / test.frequency**2, rtol=1e-12)
    np.testing.assert_allclose(test.sigma, 1e-3 * STANDARD_GRAVITY / test.frequency**2, rtol=1e-12)


def test_noise_of_accelerometers_that_is_not_given_is_found_even_in_acceleration() -> None:
    """By the readings alone; 40 windows know a variance to a quarter, and their median errs by no more."""
    table, _ = accelerations(1e-3, 1)
    fit = plain_fit(MODELS["whirl-whip"](), rf.read(table), known=KNOWN)
    block = fit.problem.blocks[0]
    own = block.sigma * (2 * np.pi * table["frequency_hz"].to_numpy().reshape(4, -1)[0, 0]) ** 2
    assert own.max() / own.min() > 50  # as (80 Hz / 4 Hz)^2 = 400 times as large below as above, by channel
    assert 0.7 < fit.redchi < 1.4


def test_noise_of_accelerometers_beside_that_of_the_force_is_told_apart() -> None:
    """A force that jitters by 2 % beside 2 mg: noise even in the motion falls off as w^-2, which looks like the
    response. Levels of 2 x 120 values err by 5 %, and the two parts trade."""
    table, a = accelerations(0.0, 0)
    rng = np.random.default_rng(2)
    jitter, sensor = rng.standard_normal((2, a.size)) + 1j * rng.standard_normal((2, a.size))
    read = a * (1 + 0.02 * jitter) + 2e-3 * sensor
    fit = plain_fit(
        MODELS["whirl-whip"](),
        rf.read(table.assign(acceleration_g=np.abs(read), phase_deg=np.degrees(np.angle(read)))),
        known=KNOWN,
    )
    assert fit.noise is not None
    assert len(fit.noise.response_noise) == 4
    for level in fit.noise.response_noise:
        assert level.unit == "m/s^2"
        assert level.constant == pytest.approx(2e-3 * STANDARD_GRAVITY, rel=0.35)
        assert level.share == pytest.approx(0.02, rel=0.35)


@pytest.mark.parametrize("kind", ["velocity_mm_s", "velocity_in_s_rms", "acceleration_mm_s2", "real"])
def test_other_sensors_and_parts(kind: str) -> None:
    test = at_rest()
    columns, a = accelerations(0.0, 0)
    columns = columns.drop(columns=["acceleration_g", "phase_deg"])
    v = 1j * test.frequency * test.response
    size, phase = np.abs(v), np.degrees(np.angle(v))
    if kind == "velocity_mm_s":
        columns = columns.assign(**{kind: size * 1e3, "phase_deg": phase})
    elif kind == "velocity_in_s_rms":
        columns = columns.assign(**{kind: size / 0.0254 / np.sqrt(2), "phase_lag_deg": -phase})
    elif kind == "acceleration_mm_s2":
        columns = columns.assign(**{kind: np.abs(a) * STANDARD_GRAVITY * 1e3, "phase_rad": np.angle(a)})
    else:
        columns = columns.assign(real_g=a.real, imag_g=a.imag)
    found = rf.read(columns)
    assert isinstance(found, PerturbationTest)
    np.testing.assert_allclose(found.response, test.response, rtol=1e-12)


def test_a_backward_reading_z_of_a_velocity_turns_backward() -> None:
    table = "run,speed_rpm,frequency_rad_s,force_plane,force_N,force_phase_deg,plane,direction,velocity_m_s,phase_deg\n"
    rows = "a,600,-50,journal,1,0,journal,z,0.5,90\na,600,50,journal,1,0,journal,z,0.5,90\n"
    found = read_text(table + rows)
    np.testing.assert_allclose(found.response, [-0.01, 0.01], rtol=1e-12)  # 0.5j / (j w)


def read_text(text: str, **options: object) -> PerturbationTest:
    from io import StringIO

    test = rf.read(pd.read_csv(StringIO(text), dtype=str, keep_default_na=False), **options)  # type: ignore[arg-type]
    assert isinstance(test, PerturbationTest)
    return test


def test_a_flow_velocity_beside_the_readings_stays_a_condition() -> None:
    head = "run,speed_rpm,frequency_rpm,force_plane,force_N,force_phase_deg,plane,direction,amplitude_um,phase_deg"
    found = read_text(f"{head},velocity_m_s\na,600,100,j,1,0,j,x,5,0,3.5\na,600,200,j,1,0,j,x,5,0,3.5\n")
    assert found.attributes["velocity_m_s"].tolist() == [3.5, 3.5]
    assert found.response.tolist() == pytest.approx([5e-6, 5e-6])


def test_probes_and_accelerometers_stand_in_one_table() -> None:
    head = "run,speed_rpm,frequency_rad_s,force_plane,force_N,force_phase_deg,plane,direction,amplitude_um,"
    rows = "a,0,100,j,1,0,j,x,5,,0\na,0,100,j,1,0,k,x,,0.01,180\n"
    found = read_text(f"{head}acceleration_m_s2,phase_deg\n{rows}")
    assert found.response.tolist() == pytest.approx([5e-6, 1e-6])
    assert found.derivative.tolist() == [0, 2]


def test_a_wide_table_has_accelerometers_with_their_coherence() -> None:
    head = "run,speed_rpm,frequency_rad_s,force_plane,force_N,force_phase_deg,force_direction,averages,"
    text = f"{head}j_x_acceleration_g,j_x_deg,j_x_coherence,k_x_velocity_mm_s,k_x_deg,k_x_coherence\n"
    found = read_text(f"{text}a,0,100,j,1,0,x,20,0.01,180,0.9,5,90,0.99\n")
    assert found.response.tolist() == pytest.approx([0.01 * STANDARD_GRAVITY / 1e4, 5e-5])
    assert (found.sigma / np.abs(found.response)).tolist() == pytest.approx(
        [np.sqrt((1 - g) / (2 * 17 * g)) for g in (0.9, 0.99)]
    )


@pytest.mark.parametrize("suffix", ["csv", "nc", "mat"])
def test_files_keep_what_was_measured(tmp_path: Path, suffix: str) -> None:
    test = rf.read(accelerations(1e-3, 0)[0])
    rf.write(test, tmp_path / f"t.{suffix}")
    back = rf.read(tmp_path / f"t.{suffix}")
    assert isinstance(back, PerturbationTest)
    assert (back.derivative == 2).all()
    np.testing.assert_allclose(back.response, test.response, rtol=1e-9)  # type: ignore[union-attr]


def test_accelerances_of_universal_files_have_even_noise_in_acceleration_too(tmp_path: Path) -> None:
    import pyuff

    test = at_rest()
    one = test.select((test.plane == "disk") & (test.force_plane == "disk"))
    record = {
        "type": 58, "func_type": 4, "rsp_node": 1, "rsp_dir": 1, "ref_node": 1, "ref_dir": 1, "id1": "", "id2": "NONE",
        "id3": "", "id4": "", "id5": "", "rsp_ent_name": "disk", "ref_ent_name": "disk", "load_case_id": 0,
        "abscissa_spec_data_type": 18, "ordinate_spec_data_type": 12, "orddenom_spec_data_type": 13,
        "z_axis_spec_data_type": 19, "z_axis_value": 0.0, "x": one.frequency / (2 * np.pi),
        "data": -(one.frequency**2) * one.response / 5.0, "binary": 0,
    }  # fmt: skip
    pyuff.UFF(str(tmp_path / "a.uff")).write_sets([record], mode="overwrite")
    with pytest.warns(UserWarning, match="no unit is said"):
        found = rf.read(tmp_path / "a.uff")
    assert isinstance(found, PerturbationTest)
    assert (found.derivative == 2).all()
    np.testing.assert_allclose(found.response, one.response / 5.0, rtol=1e-5)


# ---- coherence ------------------------------------------------------------------------------------------------------


def averaged(averages: int, seed: int, noise: float) -> pd.DataFrame:
    """Responses and coherence by H1 from blocks of random force, as an analyser averages them."""
    test, rng = at_rest(), np.random.default_rng(seed)
    H = -(test.frequency**2) * test.response / 5.0

    def normal() -> ComplexArray:
        shape = (averages, H.size)
        return np.asarray(rng.standard_normal(shape) + 1j * rng.standard_normal(shape))

    force = normal()
    a = H * force + noise * normal()
    power, cross = (np.abs(force) ** 2).mean(0), (a * force.conj()).mean(0)
    found = cross / power
    coherence: Float = np.abs(cross) ** 2 / (power * (np.abs(a) ** 2).mean(0))
    return pd.DataFrame(
        {
            "run": test.run, "speed_rpm": 0.0, "frequency_hz": test.frequency / (2 * np.pi), "force_N": 1.0,
            "force_phase_deg": 0.0, "force_direction": "x", "force_plane": test.force_plane, "plane": test.plane,
            "direction": "x", "acceleration_m_s2": np.abs(found), "phase_deg": np.degrees(np.angle(found)),
            "coherence": coherence, "averages": averages,
        }
    )  # fmt: skip


def test_errors_by_coherence_cover_the_truth() -> None:
    """40 draws of 4 parameters from 10 averages each, by H1 of random force: nothing that the formula knows of."""
    inside, redchi = [], []
    for seed in range(40):
        fit = plain_fit(MODELS["whirl-whip"](), rf.read(averaged(10, seed, 0.05)), known=KNOWN)
        redchi.append(fit.redchi)
        for key in ("Md", "K1", "D", "K0"):
            low, high = fit.interval(key, 0.95, share="noise")
            inside.append(low <= TRUTH[key] <= high)
    # parameters of a draw go together: as if 80 were independent, 0.95 +- 3 * 0.024
    assert 0.87 <= np.mean(inside) <= 1.0
    assert 0.75 < np.mean(redchi) < 1.0  # (n - 3) / (n - 2) = 0.875 by the choice of n - 3


HEAD = (
    "run,speed_rpm,frequency_hz,force_plane,force_N,force_phase_deg,force_direction,plane,direction,acceleration_g,"
    "phase_deg,coherence"
)
ROW = "a,0,{f},disk,1,0,x,disk,x,0.01,0,{c}"


def coherent(*values: str, averages: str = ",20", start: float = 10.0) -> str:
    rows = [ROW.format(f=start + k, c=value) + averages for k, value in enumerate(values)]
    return "\n".join([HEAD + (",averages" if averages else ""), *rows, ""])


@pytest.mark.parametrize(
    "text",
    [
        coherent("0.9", "0.8", averages=""),
        coherent("98", "97"),
        coherent("-0.1", "0.9"),
        coherent("1", "1"),
        coherent("0", "0"),
        coherent("0.9", "0.8", averages=",1"),
        coherent("0.9", "0.8", averages=",many"),
        coherent("0.9,20,1e-6", "0.8,20,1e-6", averages="").replace("coherence", "coherence,averages,sigma_g"),
    ],
)
def test_a_coherence_that_says_nothing_is_refused(text: str) -> None:
    with refuses(ValueError):
        read_text(text)


def test_rounded_ones_zeros_and_blanks() -> None:
    with warns(UserWarning):
        found = read_text(coherent("1.00", "0.90", "0", ""))
    assert len(found) == 3
    size = np.abs(found.response)
    expected = [np.sqrt(0.005 / (2 * 17 * 0.995)), np.sqrt(0.1 / (2 * 17 * 0.9)), np.nan]
    np.testing.assert_allclose(found.sigma / size, expected, rtol=1e-12)


def test_a_line_at_frequency_zero_is_left_out_with_a_word() -> None:
    with warns(UserWarning):
        found = read_text(coherent("0.9", "0.9", "0.8", start=0.0))
    assert len(found) == 2


@pytest.mark.parametrize(
    "table",
    [
        "acceleration_g,velocity_mm_s,phase_deg\na,0,9,j,1,0,j,x,1,1,0\n",
        "acceleration_furlong,phase_deg\na,0,9,j,1,0,j,x,1,0\n",
        "acceleration_g\na,0,9,j,1,0,j,x,1\n",
        "acceleration_g,phase_deg\na,0,9,j,1,0,j,rx,1,0\n",
    ],
)
def test_accelerations_in_doubt_are_refused(table: str) -> None:
    head = "run,speed_rpm,frequency_rpm,force_plane,force_N,force_phase_deg,plane,direction,"
    with refuses(ValueError):
        read_text(head + table)
