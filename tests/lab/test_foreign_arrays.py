"""netCDF and MAT files that others wrote: other units, names by hand, incomplete ones."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analyser_files import MODE, SPEED, Complex, W
from sentences import refuses

import rotorfit as rf
from rotorfit.lab.data.experiments import PerturbationTest
from rotorfit.lab.data.rows import Experiment
from rotorfit.models import OneMode


def columns_by_hand() -> dict[str, Any]:
    model = OneMode()
    w = np.concatenate([-W[::-1], W])
    response = 2.0 * model.receptance(model.vector(MODE), w, np.full(w.size, SPEED))[:, 0, 0]
    return {
        "run": ["bwd"] * W.size + ["fwd"] * W.size, "speed": SPEED, "frequency": w, "force_plane": ["journal"] * w.size,
        "force": 2.0, "plane": ["journal"] * w.size, "direction": ["z"] * w.size, "response": response,
    }  # fmt: skip


def assert_by_hand(test: Experiment, rtol: float = 1e-14) -> None:
    columns = columns_by_hand()
    assert isinstance(test, PerturbationTest)
    assert np.isnan(test.sigma).all()
    for name, values in columns.items():
        if isinstance(values, list):
            assert getattr(test, name).tolist() == values
        else:
            np.testing.assert_allclose(getattr(test, name), np.broadcast_to(values, len(test)), rtol=rtol)


def dataset(**units: str) -> Any:
    """The columns by hand as an xarray data set, in other units where asked."""
    import xarray as xr

    from rotorfit.base.units import units_of

    factors = units_of("frequency", "displacement", "force")
    columns = columns_by_hand()
    columns["response_real"], columns["response_imag"] = columns["response"].real, columns["response"].imag
    columns["force_real"], columns["force_imag"] = columns["force"], 0.0
    del columns["response"], columns["force"]
    variables: dict[str, Any] = {}
    for name, values in columns.items():
        unit = units.get(name.removesuffix("_real").removesuffix("_imag"))
        array = np.asarray(values) if unit is None else np.asarray(values) / factors[unit.lower().replace("/", "_")]
        variables[name] = (("row",) if array.ndim else (), array, {} if unit is None else {"units": unit})
    return xr.Dataset(variables)


def test_netcdf_by_hand(tmp_path: Path) -> None:
    content = dataset()
    content["oil_C"] = ("row", np.linspace(30, 40, content.sizes["row"]))
    content["rig"] = "seal 3"
    content["calibration"] = (("a", "b"), np.eye(3))
    content.to_netcdf(tmp_path / "t.nc", engine="h5netcdf")
    test = rf.read(tmp_path / "t.nc")
    assert_by_hand(test)
    assert list(test.attributes) == ["oil_C", "rig"]
    assert set(test.attribute("rig").tolist()) == {"seal 3"}
    assert test.attribute("oil_C")[-1] == 40


def test_classic_netcdf(tmp_path: Path) -> None:
    dataset().to_netcdf(tmp_path / "t.nc", engine="scipy")
    assert (tmp_path / "t.nc").read_bytes()[:3] == b"CDF"
    assert_by_hand(rf.read(tmp_path / "t.nc"))


def test_netcdf_in_other_units(tmp_path: Path) -> None:
    dataset(speed="rpm", frequency="Hz", response="um_pp", force="lbf").to_netcdf(tmp_path / "t.nc", engine="h5netcdf")
    assert_by_hand(rf.read(tmp_path / "t.nc"))
    content = dataset(response="um")
    content["response_imag"].attrs["units"] = "thou"
    content.to_netcdf(tmp_path / "t.nc", engine="h5netcdf")
    with refuses(ValueError):
        rf.read(tmp_path / "t.nc")


def test_static_loads_by_hand_in_other_units(tmp_path: Path) -> None:
    import xarray as xr

    def parts(name: str, values: Complex, unit: str) -> dict[str, Any]:
        both = {f"{name}_real": values.real, f"{name}_imag": values.imag}
        return {key: ("load", column, {"units": unit}) for key, column in both.items()}

    load, moved = np.array([10.0 + 5j, 20.0 - 3j]), np.array([12.0 + 1j, 24.0 - 2j])
    content = xr.Dataset(
        {"run": "a", "speed": ((), 3000.0, {"units": "rpm"}), "load_plane": "seal", "plane": "seal"}
        | parts("load", load, "lbf")
        | parts("displacement", moved, "um"),
        attrs={"kind": "StaticTest"},
    )
    content.to_netcdf(tmp_path / "t.nc", engine="h5netcdf")
    test = rf.read(tmp_path / "t.nc")
    assert type(test).__name__ == "StaticTest"
    np.testing.assert_allclose(test.speed, 100 * np.pi)
    np.testing.assert_allclose(getattr(test, "load"), load * 4.4482216152605)  # noqa: B009
    np.testing.assert_allclose(getattr(test, "displacement"), moved * 1e-6)  # noqa: B009
    table = xr.Dataset({"run": "a", "kxx": ("row", [1.0], {"units": "MN/m"})}, attrs={"kind": "CoefficientTable"})
    table.to_netcdf(tmp_path / "t.nc", engine="h5netcdf")
    with refuses(ValueError):
        rf.read(tmp_path / "t.nc")


def test_mat_by_hand(tmp_path: Path) -> None:
    from scipy.io import savemat

    columns = columns_by_hand()
    cells = {name: np.array(v, dtype=object) for name, v in columns.items() if isinstance(v, list)}
    savemat(tmp_path / "t.mat", columns | cells | {"oil_C": 41.5, "psi": np.eye(3)})
    test = rf.read(tmp_path / "t.mat")
    assert_by_hand(test)
    assert list(test.attributes) == ["oil_C"]
    assert set(test.attribute("oil_C").tolist()) == {41.5}
    savemat(tmp_path / "t.mat", columns)  # lists of names as a character matrix, filled up with blanks
    assert_by_hand(rf.read(tmp_path / "t.mat"))


@pytest.mark.parametrize("suffix", [".nc", ".mat"])
@pytest.mark.parametrize(
    "change",
    [
        {"response": None},
        {"plane": None, "run": None},
        {"frequency": "fast"},
        {"frequency": W},
        {"direction": ["q"] * 2 * W.size},
        {"kind": "BalancingTest"},
    ],
)
def test_incomplete_files_are_refused(tmp_path: Path, suffix: str, change: dict[str, Any]) -> None:
    columns = {name: v for name, v in (columns_by_hand() | change).items() if v is not None}
    path = tmp_path / f"t{suffix}"
    if suffix == ".mat":
        from scipy.io import savemat

        savemat(path, columns)
    else:
        import xarray as xr

        parts = {k: v for name, values in columns.items() for k, v in real_parts(name, values)}
        kind = {"kind": parts.pop("kind")} if "kind" in parts else {}
        arrays = {name: np.asarray(values) for name, values in parts.items()}
        variables = {name: ((f"n{v.size}",) if v.ndim else (), v) for name, v in arrays.items()}
        xr.Dataset(variables, attrs=kind).to_netcdf(path, engine="h5netcdf")
    with refuses(ValueError) as error:
        rf.read(path)
    assert str(error.value).startswith(f"t{suffix}: ")


def real_parts(name: str, values: Any) -> Iterator[tuple[str, Any]]:
    if np.iscomplexobj(values):
        yield f"{name}_real", values.real
        yield f"{name}_imag", values.imag
    else:
        yield name, values
