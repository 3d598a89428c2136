"""Forces measured along x and y at once, as on a floating stator: read, written, fitted, and with their noise."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from plain import plain_fit
from seal_rig import FLUID, STATOR_MASS, dry_stiffness, floating_stator, matrices
from sentences import refuses

import rotorfit as rf
from rotorfit.lab.data.experiments import PerturbationTest

HZ = np.linspace(20.0, 200.0, 7)
HZ_FINE = np.linspace(20.0, 200.0, 61)
MODEL = rf.models.Anisotropic(("stator",))


def read(table: pd.DataFrame) -> PerturbationTest:
    test = rf.read(table)
    assert isinstance(test, PerturbationTest)
    return test


def test_cross_talk_that_was_measured_biases_nothing() -> None:
    """Exact readings under both forces give the coefficients back, which the main force alone does not."""
    table = floating_stator(speeds_rpm=[3000.0], cross_talk=0.03, exact=True, mass=0.0)
    test = read(table)
    assert test.forces == ("stator along x + stator along y", "stator along y + stator along x")
    fit = plain_fit(MODEL, test)
    truth = FLUID(3000.0)
    for name, value in truth.items():
        assert fit.params[name].value == pytest.approx(value, rel=1e-8, abs=1e-6), name
    main = table.assign(
        force_N=np.where(table["run"].str.endswith("x"), table["force_x_N"], table["force_y_N"]),
        force_phase_deg=np.where(
            table["run"].str.endswith("x"), table["force_x_phase_deg"], table["force_y_phase_deg"]
        ),
        force_direction=table["run"].str[-1],
    ).drop(columns=["force_x_N", "force_x_phase_deg", "force_y_N", "force_y_phase_deg"])
    alone = plain_fit(MODEL, rf.read(main))
    assert max(abs(alone.params[name].value / truth[name] - 1) for name in ("Kxx", "Kxy", "Kyx", "Kyy")) > 0.005


@pytest.mark.parametrize("apart", [0.0, 0.02, 3.0])
def test_runs_of_a_pair_log_speeds_a_little_apart(apart: float) -> None:
    """x- and y-shaken at one set speed are inverted together, up to a thousandth of 3000 rpm."""
    table = floating_stator(speeds_rpm=[3000.0], exact=True, mass=0.0, frequency_hz=HZ)
    table["speed_rpm"] += apart * table["run"].str.endswith("y")
    fit = plain_fit(MODEL, read(table))
    (row,) = fit.frequency_coefficients().rows
    K, D, M = (matrix.reshape(4, 1) for matrix in matrices(FLUID(3000.0)))
    np.testing.assert_allclose(row.frequency, 2 * np.pi * HZ)
    np.testing.assert_allclose(row.stiffness, K - row.frequency**2 * M, rtol=1e-9)
    np.testing.assert_allclose(row.damping, np.tile(D, HZ.size), rtol=1e-9)


def test_repeats_without_noise_are_sweeps_though_the_other_force_is_the_greater_at_some_lines() -> None:
    """The passive shaker pulls more than the driven one where the stator resonates along the driven axis."""
    tables = [floating_stator(speeds_rpm=[3000.0], motion_noise=0.05, frequency_hz=HZ_FINE, seed=k) for k in range(3)]
    for number, table in enumerate(tables):
        near = np.abs(table["frequency_hz"] - 110.0) < 3.0
        table.loc[near & table["run"].str.endswith("x"), "force_x_N"] *= 0.02
        table["run"] += f" {number}"
    fit = plain_fit(MODEL, read(pd.concat(tables)))
    (block,) = fit.problem.responses
    assert np.median(block.sigma) == pytest.approx(0.05e-6, rel=0.2)


def test_an_isotropic_model_sees_both_forces_forward_and_backward() -> None:
    """kappa = K - jk ... of z at w: Kxx = Kyy = K0 and Kxy = -Kyx = D lam Om in real coordinates."""
    fluid = {"Kxx": 2e6, "Kyy": 2e6, "Kxy": 8e5, "Kyx": -8e5, "Dxx": 4e3, "Dyy": 4e3, "Dxy": 0.0, "Dyx": 0.0}
    mass = {"Mxx": 3.0, "Myy": 3.0, "Mxy": 0.0, "Myx": 0.0}
    table = floating_stator(speeds_rpm=[3000.0], cross_talk=0.05, exact=True, mass=0.0, fluid=lambda _: fluid | mass)
    model = rf.models.OneMode(planes=("stator",))
    fit = plain_fit(model, rf.read(table), known={"K": 0.0, "Ds": 0.0, "Mf": 0.0})
    found = {name: fit.params[name].value for name in ("K0", "D", "lam", "M")}
    lam = 8e5 / (4e3 * 100 * np.pi)
    assert found == pytest.approx({"K0": 2e6, "D": 4e3, "lam": lam, "M": 3.0}, rel=1e-8)


@pytest.mark.parametrize("suffix", [".csv", ".nc", ".mat"])
def test_files_keep_both_forces(tmp_path: Path, suffix: str) -> None:
    test = read(floating_stator(speeds_rpm=[3000.0], force_sigma=0.2))
    rf.write(test, tmp_path / f"again{suffix}")
    again = rf.read(tmp_path / f"again{suffix}")
    assert isinstance(again, PerturbationTest)
    assert again.forces == test.forces
    np.testing.assert_allclose(again.force, test.force, rtol=1e-12)
    second = [[acting[0][1] for acting in one.further_forces.tolist()] for one in (test, again)]
    np.testing.assert_allclose(second[1], second[0], rtol=1e-12)
    assert (again.force_sigma == 0.2).all()


def test_a_mat_file_of_the_laboratory_has_them_too(tmp_path: Path) -> None:
    from scipy.io import savemat

    table = floating_stator(speeds_rpm=[3000.0])
    variables = {
        name: values.to_numpy(dtype=object if values.dtype.kind == "O" else None) for name, values in table.items()
    }
    savemat(tmp_path / "lab.mat", variables)
    test = rf.read(tmp_path / "lab.mat")
    assert isinstance(test, PerturbationTest)
    np.testing.assert_allclose(test.force, read(table).force, rtol=1e-12)


def test_a_universal_file_with_both_references_has_a_dry_run(tmp_path: Path) -> None:
    """Responses to forces along x and along y, wet at two speeds and dry, as an analyser solves for them."""
    import pyuff

    hz = np.linspace(20.0, 200.0, 61)
    w, rng = 2 * np.pi * hz, np.random.default_rng(1)
    for name, speeds in (("wet", (1500.0, 3000.0)), ("dry", (0.0,))):
        records = []
        for rpm in speeds:
            K, D, _ = matrices(FLUID(rpm))
            fluid = (K + 1j * w[:, None, None] * D) * (name == "wet")
            H = np.linalg.inv(dry_stiffness(w, STATOR_MASS) + fluid)
            noise = 2e-10 if rpm else 2e-9
            for i, j in np.ndindex(2, 2):
                frf = H[:, i, j] + noise * (rng.normal(size=w.size) + 1j * rng.normal(size=w.size))
                records.append(
                    pyuff.prepare_58(
                        binary=0, func_type=4, ref_node=7, ref_dir=j + 1, rsp_node=7, rsp_dir=i + 1, x=hz, data=frf,
                        num_pts=w.size, ord_data_type=6, abscissa_spacing=1, abscissa_spec_data_type=18,
                        ordinate_spec_data_type=8, orddenom_spec_data_type=13, ordinate_axis_units_lab="m",
                        orddenom_axis_units_lab="N", z_axis_spec_data_type=19, z_axis_value=rpm,
                    )
                )  # fmt: skip
        pyuff.UFF(str(tmp_path / f"{name}.uff")).write_sets(records, mode="overwrite")
    names = [kind + row + column for kind in "KD" for row in "xy" for column in "xy"]
    fit = plain_fit(
        rf.models.Anisotropic(("7",)),
        rf.read(tmp_path / "wet.uff"),
        baseline=rf.read(tmp_path / "dry.uff"),
        known={f"M{row}{column}": 0.0 for row in "xy" for column in "xy"},
        per=dict.fromkeys(names, "speed_rpm"),
    )
    found = [fit.params[f"{name}[speed_rpm={rpm}]"] for name in names for rpm in (1500, 3000)]
    truth = [FLUID(rpm)[name] for name in names for rpm in (1500, 3000)]
    assert max(abs(p.value - value) / p.stderr for p, value in zip(found, truth, strict=True)) < 4


def test_a_wide_table_has_them_beside_its_probes() -> None:
    head = "run,speed_rpm,frequency_hz,force_x_N,force_x_phase_deg,force_y_kN,force_y_phase_lag_deg,force_plane,"
    text = f"{head}stator_x_um,stator_x_deg,stator_y_um,stator_y_deg\na,3000,20,100,0,0.003,30,stator,5,-10,1,20\n"
    test = rf.read(pd.read_csv(StringIO(text)))
    assert isinstance(test, PerturbationTest)
    assert (len(test), test.forces) == (2, ("stator along x + stator along y",))
    plane, force, axis = test.further_forces[0][0]
    assert (plane, axis) == ("stator", "y")
    assert force == pytest.approx(3 * np.exp(-1j * np.pi / 6))


def test_at_rest_the_force_along_the_reading_counts() -> None:
    """One direction of a rotor at rest, under a shaker whose cross-talk was measured."""
    truth = {"K": 2e6, "Ds": 900.0, "M": 4.0}
    w = 2 * np.pi * np.linspace(10, 200, 60)
    force = 80 * np.exp(0.3j)
    x = force / (truth["K"] + 1j * w * truth["Ds"] - w**2 * truth["M"])
    table = pd.DataFrame(
        {
            "run": "a", "speed_rpm": 0.0, "frequency_rad_s": w, "force_x_N": 80.0, "force_x_phase_rad": 0.3,
            "force_y_N": 200.0, "force_y_phase_rad": 1.0, "plane": "journal", "direction": "x",
            "amplitude_m": np.abs(x), "phase_rad": np.angle(x),
        }
    )  # fmt: skip
    fit = plain_fit(rf.models.OneMode(), rf.read(table), known={"K0": 0.0, "D": 0.0, "lam": 0.4, "Mf": 0.0})
    assert {name: fit.params[name].value for name in truth} == pytest.approx(truth, rel=1e-8)


HEAD = "run,speed_rpm,frequency_hz,plane,direction,amplitude_um,phase_deg"
ROW = "a,3000,20,stator,x,5,0"


@pytest.mark.parametrize(
    "text",
    [
        f"{HEAD},force_x_N\n{ROW},100\n",
        f"{HEAD},force_x_N,force_x_phase_deg,force_N\n{ROW},100,0,5\n",
        f"{HEAD},force_x_N,force_x_phase_deg,force_y_N,force_y_phase_deg\n{ROW},100,0,,0\n",
        f"{HEAD},force_x_N,force_x_kN,force_x_phase_deg\n{ROW},100,1,0\n",
        f"{HEAD},force_x_N,force_x_phase_deg,force_sigma_N\n{ROW},100,0,-1\n",
        f"{HEAD},force_x_N,force_x_phase_deg\n{ROW.replace('20', '-20')},100,0\n",
        f"{HEAD},force_x_N,force_x_phase_deg,force_direction\n{ROW},100,0,x\n",
    ],
)
def test_columns_in_doubt_are_refused(text: str) -> None:
    with refuses(ValueError):
        rf.read(pd.read_csv(StringIO(text), dtype=str, keep_default_na=False))


def test_circular_forces_and_forces_along_axes_do_not_mix() -> None:
    columns = {"run": "a", "speed": 100.0, "frequency": 50.0, "plane": "s", "direction": "x", "response": 1e-6 + 1e-7j}
    with refuses(ValueError):
        rf.perturbation_test(
            **columns,
            force_plane=["s", "s"],
            force=[1.0, 2.0],
            force_direction=["x", "circular"],  # type: ignore[arg-type]
        )
    with refuses(ValueError):
        rf.perturbation_test(
            **columns,
            force_plane=["s"] * 3,
            force=[1.0, 2.0, 3.0],
            force_direction=["x", "y", "x"],  # type: ignore[arg-type]
        )
