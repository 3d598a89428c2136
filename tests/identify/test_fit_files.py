"""Results in files: everything back, bit by bit; clear words for files that are not right."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace

import numpy as np
import pytest
from beams import shaft
from law_data import CLEARANCE_UM, LIGHT, impulse, off_centre, ring_down, squeeze, static, sweep
from plain import plain_fit
from scipy import stats
from sentences import refuses
from synthetic import TYPICAL, circular_test

import rotorfit as rf
from rotorfit.base.faults import of_program
from rotorfit.base.version import VERSIONS
from rotorfit.identify.fitting.fit_file import fit_from_json, fit_to_json
from rotorfit.models import Chain, EvenPolynomial, KnownStructure, MonotoneSpline, Muszynska, OneMode, WhirlWhip
from rotorfit.models.model import RotorModel
from rotorfit.models.parameters import Parameter

W = np.r_[-np.linspace(20, 400, 25)[::-1], np.linspace(20, 400, 25)]


def parts(value):
    """The parts that make a value, by name; None for one that has no parts."""
    if isinstance(value, RotorModel):
        return value.options()
    if hasattr(value, "dist"):
        return {"name": value.dist.name, "args": value.args, "kwds": value.kwds}
    if is_dataclass(value):
        return {f.name: getattr(value, f.name) for f in fields(value) if f.name not in ("problem", "fit")}
    if isinstance(value, (tuple, list)):
        return dict(enumerate(value))
    return value if isinstance(value, Mapping) else None


def differences(a, b, where="fit"):
    """Places at which two values differ in type or in any bit, the optimisation problem aside."""
    if type(a) is not type(b):
        return [where]
    if isinstance(a, np.ndarray):
        return [] if (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes()) else [where]
    mine, theirs = parts(a), parts(b)
    if mine is None:
        return [] if repr(a) == repr(b) else [where]
    if list(mine) != list(theirs):
        return [where]
    return [d for key in mine for d in differences(mine[key], theirs[key], f"{where}.{key}")]


def one_mode_test(**options):
    model = OneMode()
    return circular_test(
        model, model.vector(TYPICAL["one-mode"]), speeds=(100.0, 180.0), frequency=W, noise=0.01, seed=3, **options
    )


def test_a_saved_fit_is_the_same_fit(rig_fit, tmp_path):
    path = tmp_path / "fit.json"
    rig_fit.save(path)
    loaded = rf.load_fit(path)
    assert differences(rig_fit, loaded) == []
    assert loaded.summary() == rig_fit.summary()
    again = rf.fit(loaded.model, loaded.experiments, known=loaded.settings.known)
    # The data came back to the last bit. What is fitted to them anew differs in the last digits all the same, where
    # NumPy's arrays lie elsewhere in memory; both searches end within 1e-10 of the misfit, far below a millionth of an
    # error.
    assert (np.abs(again.x - rig_fit.x) < 1e-6 * np.sqrt(np.diag(rig_fit.covar))).all()
    assert again.warnings == rig_fit.warnings
    assert [p.name for p in tmp_path.iterdir()] == ["fit.json"]


def test_everything_that_can_be_asked_for_comes_back():
    test = one_mode_test(sigma_known=True)
    oil = np.where(test.speed < 150, 40.5, 52.25)
    test = replace(
        test,
        attributes={"oil_C": oil, "day": np.where(oil > 50, "Tue", "Mön"), "batch": np.full(len(test), 7)},
        sigma=np.where(np.arange(len(test)) % 2, test.sigma, np.nan),
    )
    fit = plain_fit(
        OneMode(),
        [test.select(test.run == name) for name in test.runs],
        known={"K": 8000.0, "Ds": 8.0},
        bounds={"lam": (0.1, np.inf)},
        priors={"Mf": stats.norm(0.4, scale=0.1), "lam": stats.beta(20, 22), "K0": stats.uniform(0, 1e5)},
        per={"D": "oil_C"},
        start={"D[oil_C=40.5]": 150.0},
        loss="soft_l1",
        phase_offsets=True,
    )
    loaded = fit_from_json(fit_to_json(fit))
    assert differences(fit, loaded) == []
    assert "D[oil_C=40.5]" in loaded.params
    assert loaded.problem.cost(fit.x) == fit.problem.cost(fit.x)
    closed = rf.closed_form(OneMode(), test, known={"K": 8000.0, "Ds": 8.0})
    assert differences(closed, fit_from_json(fit_to_json(closed))) == []


LAWS = (Muszynska(), EvenPolynomial(terms=1), MonotoneSpline(knots=(0.1, 0.3), reach=0.6))


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_laws_come_back_with_their_options(law):
    from rotorfit.identify.fitting.json_values import decode, encode

    model = WhirlWhip(planes=("rotor", "seal"), law=law, clearance_um=127.3, blocks=("gyroscopic",), two_lam=True)
    back = decode(json.loads(json.dumps(encode(model))))
    assert differences(model, back) == []
    assert back.parameter_names == model.parameter_names


def test_models_of_many_kinds_come_back_after_a_fit():
    K, M, G = shaft(0.56, 4, 0.010, E=2.11e11, G=8.12e10, rho=7810.0)
    K[0, 0] += 5e7
    known = KnownStructure(
        M, None, G, K, planes={"disk": 2, "journal": 4}, fluid="journal", damping="disk", scales={"E": {"K": K}}
    )
    chain = Chain(3, fluid="mass-2")
    values = {
        "known-structure": {"Ds": 5.0, "K0": 1e4, "D": 450.0, "lam": 0.47, "Mf": 0.3, "E": 1.0},
        "chain": {
            **{f"M{i}": 1.0 for i in (1, 2, 3)},
            **{f"K{i}": 2e4 for i in (1, 2, 3, 4)},
            **{f"Ds{i}": 30.0 for i in (1, 2, 3)},
            "K0": 5e3,
            "D": 300.0,
            "lam": 0.45,
            "Mf": 0.2,
        },
    }
    for model in (known, chain):
        theta = model.vector(values[model.name])
        test = circular_test(model, theta, speeds=(100.0,), frequency=W, noise=0.01, seed=5, sigma_known=True)
        fit = plain_fit(model, test, start={n: v for n, v in values[model.name].items() if n != "E"})
        loaded = fit_from_json(fit_to_json(fit))
        assert differences(fit, loaded) == []
        assert loaded.threshold_speed().stderr == fit.threshold_speed().stderr


def test_experiments_of_every_kind_come_back():
    kinds = [f(LIGHT) for f in (static, impulse, off_centre, squeeze, ring_down)]
    fit = plain_fit(
        OneMode(law=Muszynska(), clearance_um=CLEARANCE_UM),
        [sweep(LIGHT, levels=(0.7, 4.0), lines=20), *kinds],
        known={"Ds": 8.0},
    )
    loaded = fit_from_json(fit_to_json(fit))
    assert differences(fit, loaded) == []
    assert [type(e) for e in loaded.experiments] == [type(e) for e in fit.experiments]


class Spring(RotorModel):
    """A model of the user's own."""

    name = "spring"
    parameters = (Parameter("k", "N/m", "stiffness", scale=1e4), Parameter("c", "N s/m", "damping", scale=10.0))

    def __init__(self, planes=("journal",)):
        self.planes = tuple(planes)

    def equation(self, p, speed, eccentricity):
        return [[p.k]], [[p.c]], [[1.0]]


def test_a_model_of_ones_own_is_given_by_the_reader(tmp_path):
    theta = np.array([9e3, 40.0])
    test = circular_test(Spring(), theta, speeds=(100.0,), frequency=W, noise=0.01, seed=1)
    fit = plain_fit(Spring(), test, start={"k": 8e3, "c": 30.0})
    path = tmp_path / "own.json"
    fit.save(path)
    with refuses(ValueError):
        rf.load_fit(path)
    assert differences(fit, rf.load_fit(path, model=Spring())) == []
    with refuses(ValueError):
        rf.load_fit(path, model=WhirlWhip())
    with refuses(ValueError):
        rf.load_fit(path, model=Spring(planes=("seal",)))


class Triangle(stats.rv_continuous):
    """A prior of the user's own."""

    def _pdf(self, x):
        return 2 * x


def test_what_a_file_cannot_hold_is_refused():
    test = one_mode_test(sigma_known=True)
    prior = Triangle(a=0, b=1, name="triangle")()
    fit = plain_fit(OneMode(), test, known={"K": 8000.0, "Ds": 8.0}, priors={"lam": prior})
    with refuses(ValueError):
        fit_to_json(fit)
    plain = plain_fit(OneMode(), test, known={"K": 8000.0, "Ds": 8.0})
    noisier = replace(plain.problem.blocks[0], sigma=2 * plain.problem.blocks[0].sigma)
    changed = replace(plain, problem=replace(plain.problem, blocks=(noisier,)), chisqr=plain.chisqr / 4)
    with refuses(ValueError):
        fit_to_json(changed)


def test_files_that_are_not_right_say_what_is_wrong(rig_fit, tmp_path):
    text = fit_to_json(rig_fit)
    content = json.loads(text)

    def broken(**changes):
        path = tmp_path / "broken.json"
        path.write_text(json.dumps({**content, **changes}), encoding="utf-8")
        return path

    cut = tmp_path / "cut.json"
    cut.write_text(text[: len(text) // 2], encoding="utf-8")
    with pytest.raises(ValueError, match=r"cut\.json is not JSON"):
        rf.load_fit(cut)
    with refuses(ValueError):
        rf.load_fit(broken(format="something"))
    with refuses(ValueError):
        rf.load_fit(broken(schema=99))
    with refuses(ValueError):
        rf.load_fit(broken(model={**content["model"], "own": {"model": "Popen", "options": {}}}))
    with refuses(ValueError):
        rf.load_fit(broken(settings={"record": "FitResult2", "fields": {}}))
    with refuses(ValueError):
        rf.load_fit(broken(settings={"distribution": "rv_continuous", "args": [], "kwds": {}}))
    odd = {"record": "FitSettings", "fields": {"lossy": 1}}
    with refuses(ValueError):
        rf.load_fit(broken(settings=odd))
    with refuses(ValueError):
        rf.load_fit(broken(x={"array": "float64", "shape": [3], "data": [1.0]}))
    x = {**content["x"], "data": [1.01 * v for v in content["x"]["data"]]}
    with refuses(ValueError):
        rf.load_fit(broken(x=x))
    del content["covar"]
    with refuses(ValueError):
        rf.load_fit(broken())
    with pytest.raises(FileNotFoundError):
        rf.load_fit(tmp_path / "absent.json")


def test_awkward_numbers_are_exact():
    from rotorfit.identify.fitting.json_values import decode, encode

    values = np.array([0.1, -0.0, 5e-324, 1.7976931348623157e308, np.nan, np.inf, -np.inf, np.nextafter(1.0, 2.0)])
    for value in (values, values.view(complex), values.reshape(2, 4), np.array(["a", "β"]), values > 0):
        back = decode(json.loads(json.dumps(encode(value), allow_nan=False)))
        assert differences(value, back) == []
    for value in (np.nan, -np.inf, -0.0, 0.1 + 2j, None, True, 3, "text", [1, (2.5, {"a": (None,)})]):
        assert differences(value, decode(json.loads(json.dumps(encode(value), allow_nan=False)))) == []


@pytest.mark.parametrize(
    ("record", "field", "value"),
    [("FittedParameter", "freedom", None), ("FittedParameter", "stderr", "x"), ("FittedParameter", "freedom", [])],
)
def test_fields_of_other_types_are_refused(rig_fit, tmp_path, record, field, value):
    """They were read, and judged with Python's words."""
    content = json.loads(fit_to_json(rig_fit))
    entry = content["params"]["mapping"][0][1]
    assert entry["record"] == record
    entry["fields"][field] = value
    (tmp_path / "fit.json").write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(ValueError, match=rf"fit\.json: record {record}: {field} must be of type float"):
        rf.load_fit(tmp_path / "fit.json")


def test_a_fit_of_another_version_is_marked(rig_fit, tmp_path, caplog):
    fit = rig_fit
    fit.save(tmp_path / "fit.json")
    rf.load_fit(tmp_path / "fit.json")
    assert not caplog.records
    text = (tmp_path / "fit.json").read_text(encoding="utf-8")
    (tmp_path / "fit.json").write_text(text.replace(VERSIONS, "0.9.1, results 0"), encoding="utf-8")
    assert rf.load_fit(tmp_path / "fit.json").redchi == fit.redchi
    [said] = [record.getMessage() for record in caplog.records]
    assert "fit.json was fitted by rotorfit 0.9.1, results 0, this is " in said


@pytest.mark.parametrize("causes", [None, {"gain": 0.005}])
def test_altered_fits_are_refused_in_words_or_read(causes, tmp_path):
    """Nodes of the file with values of another kind, lost or exchanged: never an error of the program."""
    from mutated_commands import altered

    rig = rf.datasets.rig_lumped()
    test = rig.select(np.flatnonzero(np.isin(rig.frequency, np.unique(rig.frequency)[::10])))
    fit = rf.fit(WhirlWhip(), test, known={"K3": 6000.0}, causes=causes)
    path, rng, refused = tmp_path / "fit.json", np.random.default_rng(42), []
    for _ in range(80):
        fit.save(path)
        altered(path, rng)
        try:
            rf.load_fit(path).threshold_speed()
        except ValueError as problem:
            refused.append((of_program(problem), str(problem)))
    assert len(refused) > 40
    assert [words for program, words in refused if program or str(path) not in words] == []
