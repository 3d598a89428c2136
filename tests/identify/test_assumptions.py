"""Score tests of what a model leaves out, against fits that have it."""

from __future__ import annotations

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fe_rigs import JOURNAL, K3, TYPICAL, Rig
from sentences import refuses

import rotorfit as rf
from rotorfit.estimators.inference.score_tests import score_tests, whitened_columns
from rotorfit.identify.fitting.assumptions.assumption_table import THRESHOLD_COLUMN
from rotorfit.identify.fitting.structure.refine import refit
from rotorfit.models import WhirlWhip, threshold_speed
from rotorfit.models.complexes import Complex, J
from rotorfit.models.laws import Muszynska
from rotorfit.models.motion.neglected_terms import onset_shift, terms_left_out
from rotorfit.models.parameters import Parameter


@pytest.fixture(scope="module")
def rig():
    return rf.datasets.rig_open()


@pytest.fixture(scope="module")
def plain(rig):
    return rf.fit(WhirlWhip(), rig, known={"K3": 6000.0})


def refitted(rig, name, size):
    """Fits with a term of known size on either side of zero: what one unit of it does to results."""
    model, known = WhirlWhip(blocks=("coupling_mass",)), {"K3": 6000.0}
    known |= {name: known.get(name, 0.0)}
    pair = []
    for sign in (1, -1):
        values = {"m12": 0.0} | known
        values[name] += sign * size
        pair.append(rf.fit(model, rig, known=values))
    up, down = pair
    slopes = {n: (up.params[n].value - down.params[n].value) / (2 * size) for n in ("K0", "D", "lam", "Mf")}
    return slopes | {THRESHOLD_COLUMN: (up.threshold_speed().value - down.threshold_speed().value) / (2 * size)}


@pytest.mark.parametrize(("name", "parameter", "size"), [("m[disk, journal]", "m12", 2e-4), ("K3", "K3", 20.0)])
def test_shifts_are_those_of_fits_with_the_term(rig, plain, name, parameter, size):
    """One unit of the term, from two more fits; Gauss-Newton leaves out curvature times residual, a per cent here."""
    shifts = plain.assumptions()[name].shifts
    # The plain model misses this rig by ten times the noise, and so Gauss-Newton by a share of that.
    for result, slope in refitted(rig, parameter, size).items():
        scale = {"K0": 1e4, "D": 450.0, "lam": 0.475, "Mf": 0.35, THRESHOLD_COLUMN: 280.0}[result] * 1e-5 / size
        assert shifts[result] == pytest.approx(slope, rel=0.1, abs=scale), result


def test_the_coupling_mass_that_this_shaft_has_is_asked_for_and_its_size_foretold(rig, plain):
    found = plain.assumptions()
    term = found["m[disk, journal]"]
    assert term in found.missing
    assert found.entries[0] is term  # of all, it explains most
    wide = rf.fit(WhirlWhip(blocks=("coupling_mass",)), rig, known={"K3": 6000.0})
    assert term.estimate == pytest.approx(wide.params["m12"].value, rel=0.1)


def test_external_damping_at_the_journal_cannot_be_told_from_the_fluid(plain):
    """D takes it up: D + Ds and D lam are what is seen, so D falls by one and lam rises by lam/D for each N s/m."""
    term = plain.assumptions()["Ds[journal]"]
    assert term.plausible == pytest.approx(0.03 * plain.params["D"].value)
    assert term.left > 0.5 * term.plausible  # the fluid's inertia tells a little
    assert term.shifts["D"] == pytest.approx(-1, abs=0.02)
    ratio = plain.params["lam"].value / plain.params["D"].value
    assert term.shifts["lam"] == pytest.approx(ratio, rel=0.02)


def test_refined_the_model_lacks_nothing(plain):
    best = rf.refine(plain).best
    assert not best.assumptions().missing
    assert not best.settings.priors  # two speeds tell gyroscopic effects from the fluid's inertia


class Damped(WhirlWhip):
    """Eq. (18) with coupling damping, internal damping, a w^3 gyroscopic term and one squared."""

    extra = ("c", "ci", "h", "e")

    def __init__(self) -> None:
        super().__init__()
        self.parameters = (*self.parameters, *(Parameter(name, "N s/m", "added") for name in self.extra))

    def equation(self, p: Any, speed: Any, eccentricity: Any) -> list[Complex]:
        K, C, M = (
            Complex.matrix(m) if not isinstance(m, Complex) else m for m in super().equation(p, speed, eccentricity)
        )
        cross, twist = Complex.matrix([[0.0, 1.0], [1.0, 0.0]]), Complex.matrix([[1.0, -1.0], [-1.0, 1.0]])
        K = K - J * (twist * (p.ci * speed))
        return [K, C + cross * p.c + twist * p.ci, M + cross * (p.e * speed**2), J * (cross * (p.h * speed))]


NAMES = {"c": "c[disk, journal]", "ci": "ci[disk, journal]", "h": "h[disk, journal]", "e": "e[disk, journal]"}


@pytest.mark.parametrize("extra", sorted(NAMES))
def test_columns_and_onsets_are_those_of_an_equation_with_the_term(plain, extra):
    """The same term written into the equation of motion and differentiated by CasADi."""
    model, theta = Damped(), np.concatenate([plain.theta(), np.zeros(len(Damped.extra))])
    term = next(t for t in terms_left_out(plain.model) if t.name == NAMES[extra])
    place = model.parameter_names.index(extra)
    (block,) = plain.problem.blocks
    own = type(block)(**{f: getattr(block, f) for f in block.__dataclass_fields__} | {"model": model})
    column = own.predict_jacobian(theta[None])[1][:, place] / block.sigma
    assert whitened_columns(plain.problem, plain.x, [term])[:, 0] == pytest.approx(column, rel=1e-9, abs=1e-12)
    onset = threshold_speed(plain.model, plain.theta())
    step = {"h": 1e-10, "e": 1e-9}.get(extra, 1e-3)
    band = 2 * abs(onset.whirl_frequency)  # s^3 brings roots far above
    ends = [
        threshold_speed(model, theta + sign * step * np.eye(theta.size)[place], band=band).speed for sign in (1, -1)
    ]
    assert onset_shift(plain.model, plain.theta(), onset, term) == pytest.approx(
        (ends[0] - ends[1]) / (2 * step), rel=1e-4
    )


def test_scores_are_normal_where_nothing_is_left_out():
    """Linear model, noise alone: z has unit variance, also beside a column that parameters take up entirely."""
    rng = np.random.default_rng(2)
    J = rng.normal(size=(40, 3)) + 1j * rng.normal(size=(40, 3))
    c = np.column_stack([rng.normal(size=40) + 1j * rng.normal(size=40), J @ [1.0, -2.0, 0.5]])
    z = []
    for _ in range(2000):
        noise = rng.normal(size=40) + 1j * rng.normal(size=40)
        both_real = np.concatenate([J.real, J.imag])
        x = np.linalg.lstsq(both_real, -np.concatenate([noise.real, noise.imag]), rcond=None)[0]
        scores = score_tests(noise + J @ x, J, c, np.zeros(3))
        z.append(scores.estimate[0] / scores.stderr[0])
    assert np.isnan(scores.estimate[1])
    assert np.isinf(scores.stderr[1])
    assert scores.shift[1] == pytest.approx([-1.0, 2.0, -0.5], rel=1e-9)
    assert np.std(z) == pytest.approx(1.0, abs=4 / np.sqrt(4000))
    assert abs(np.mean(z)) < 4 / np.sqrt(2000)


def test_external_damping_at_the_journal_moves_what_the_summary_says_and_not_the_threshold():
    """A rig with a damper of 20 N s/m there, and the same without: the line beside lam tells the difference."""
    found = {}
    for damper in (0.0, 20.0):
        rig = Rig(**TYPICAL)
        rig.C[2 * JOURNAL, 2 * JOURNAL] += damper
        model = WhirlWhip(blocks=("coupling_mass", "gyroscopic"))
        fit = rf.fit(model, rig.campaign(np.array([94.0, 188.0]), 3), known={"K3": K3})
        onset = fit.threshold_speed()
        assert abs(onset.value - rig.threshold()) < 4 * onset.stderr
        found[damper] = fit
    told = found[20.0].assumptions()["Ds[journal]"]
    (line,) = [words for words in found[20.0].summary().splitlines() if "Ds[journal]" in words]
    assert f"Ds[journal] {told.left:+.2g} N s/m (" in line
    assert f"shifts D by {-told.left:+.2g}, lam by +0.0" in line
    assert line.endswith("threshold speed unchanged")
    for name in ("D", "lam"):
        moved = found[0.0].params[name].value - found[20.0].params[name].value
        # lam D / (D - 20) bends: the next term of its series is 20/D of the first
        assert 20.0 * told.shifts[name] == pytest.approx(moved, rel=2 * 20.0 / 450.0), name


def test_what_rests_on_the_data_alone_is_not_in_the_summary(plain):
    """Every line names what moves a result by more than its error."""
    named = {re.split(r" [+-]", words)[0] for words in plain.assumptions().foundations}
    assert {"rest[journal]", "Ds[journal]", "K3"} <= named
    for entry in plain.assumptions().entries:
        heavy = any(abs(entry.shifts[n] * entry.left) > e for n, e in entry.errors.items())
        assert heavy == (entry.name in named), entry.name


def test_an_uncertainty_given_for_a_term_enters_the_results(plain):
    """D and external damping at the journal are known as their sum only: what the one may be, the other may be off."""
    none = dict.fromkeys((entry.name for entry in plain.assumptions().entries), 0.0)
    found = plain.assumptions(none | {"Ds[journal]": 0.5})
    assert found.systematic("D") == pytest.approx(0.5, rel=0.025)  # the fluid's inertia tells D a little
    assert found.combined("D") == pytest.approx(np.hypot(plain.params["D"].stderr, 0.5), rel=0.025)
    assert "with the systematic share" in str(found)
    assert plain.assumptions(none).systematic("D") == 0
    assert plain.assumptions().systematic("D") > 5  # a damper of three per cent, and all else
    with refuses(KeyError):
        plain.assumptions({"Ds": 2.0})
    with refuses(ValueError):
        plain.assumptions({"Ds[journal]": -0.5})


def test_a_journal_that_rests_off_centre_shows_the_fluid_of_that_eccentricity(plain):
    """The centred fluid, taken to eps = 0.05 by the law with n = 1 and b = 1/2, is the fitted one."""
    term, eps = plain.assumptions()["rest[journal]"], 0.05
    assert not term.tested
    fluid = Muszynska().at(SimpleNamespace(K0=1.0, D=1.0, n_K=1.0, n_D=1.0, b=0.5), eps)
    for name, factor in (("D", fluid.D), ("lam", fluid.ratio)):
        fitted = plain.params[name].value
        assert (fitted + eps * term.shifts[name]) * float(factor) == pytest.approx(fitted, rel=1e-9)


def test_coupling_damping_says_that_a_damper_may_act_at_the_journal():
    rig = Rig(**TYPICAL)
    rig.K[0, 0] += 2e5 - 5e7  # the rigid bearing on a spring and a damper
    rig.C[0, 0] += 60.0
    model = WhirlWhip(blocks=("coupling_mass", "gyroscopic", "coupling_damping"))
    fit = rf.fit(model, rig.campaign(np.array([94.0, 188.0]), 3), known={"K3": K3})
    term = fit.assumptions()["Ds[journal]"]
    assert term.implied
    assert term.plausible >= abs(fit.params["c12"].value)
    assert "There is coupling damping" in str(fit.assumptions())


def test_parameters_of_their_own_for_each_test_are_refused_in_words(rig):
    fit = rf.fit(WhirlWhip(), rig, known={"K3": 6000.0}, per={"D": "speed_rpm"})
    with refuses(ValueError):
        fit.assumptions()


@pytest.fixture(scope="module")
def assuming(rig):
    fit = rf.fit(WhirlWhip(), rig, known={"K3": 6000.0})
    none = dict.fromkeys((entry.name for entry in fit.assumptions().entries), 0.0)
    given = none | {"Ds[journal]": 0.5, "K3": 60.0}
    return rf.fit(WhirlWhip(), rig, known={"K3": 6000.0}, assumptions=given)


def test_uncertainties_given_to_a_fit_enter_its_intervals_and_leave_params_statistical(plain, assuming):
    for name, p in assuming.params.items():
        assert p == plain.params[name]
    for name, shift in (("D", 0.5), ("K0", 60.0)):  # each is known as a sum with what was given an uncertainty
        assert assuming.systematic(name) == pytest.approx(shift, rel=0.05)
        low, high = assuming.interval(name)
        wide = 1.959964 * np.hypot(assuming.params[name].stderr, assuming.systematic(name))
        assert (high - low) / 2 == pytest.approx(wide, rel=1e-6)
    low, high = assuming.interval("threshold_speed")
    assert high - low == pytest.approx(
        np.diff(plain.threshold_speed().interval(statistical=True))[0], rel=0.1
    )  # K3 and K0 as a sum too
    assert assuming.interval("D") == assuming.params["D"].interval()
    onset = assuming.threshold_speed()
    assert assuming.interval("threshold_speed") == onset.interval()
    for p in (plain.params["D"], plain.threshold_speed()):
        low, high = p.interval(statistical=True)
        assert (high - low) / 2 == pytest.approx(1.959964 * p.stderr)
        assert p.systematic > p.stderr


def test_digits_follow_the_sum_of_both_shares(assuming):
    text = assuming.summary()
    (row,) = [line.split() for line in text.splitlines() if line.startswith("D ")]
    p = assuming.params["D"]
    assert row[1] == f"{p.value:.2f}"  # by 0.59 in all
    assert float(row[2]) == pytest.approx(p.stderr, rel=0.05)
    assert float(row[4]) == pytest.approx(p.systematic, rel=0.05)
    onset = assuming.threshold_speed()
    assert str(onset).endswith(f"({onset.stderr:.2g} statistical, {onset.systematic:.2g} systematic)")


def test_they_stand_in_the_report_and_in_a_saved_fit(assuming, tmp_path):
    page = rf.write_report(assuming, tmp_path / "report.html", figure_format="none").read_text(encoding="utf-8")
    assert "statistical, ± " in page
    assert "--assumption" in page
    rf.save_fit(assuming, tmp_path / "fit.json")
    assert rf.load_fit(tmp_path / "fit.json").interval("lam") == pytest.approx(assuming.interval("lam"), rel=1e-12)


def test_a_refinement_keeps_those_that_its_candidates_have_no_parameter_for(rig):
    fit = rf.fit(WhirlWhip(), rig, known={"K3": 6000.0}, assumptions={"Ds[journal]": 0.5, "m[disk, journal]": 0.02})
    wide = refit(fit, WhirlWhip(blocks=("coupling_mass",)))
    assert dict(wide.settings.assumptions) == {"Ds[journal]": 0.5}
    assert wide.assumptions()["Ds[journal]"].uncertainty == 0.5
    assert wide.assumptions()["K3"].uncertainty == 60.0  # as it is plausible


def test_uncertainties_of_what_is_not_in_the_table_are_refused(rig):
    with refuses(KeyError):
        rf.fit(WhirlWhip(), rig, known={"K3": 6000.0}, assumptions={"De": 2.0})
    with refuses(KeyError):
        rf.fit(WhirlWhip(), rig, known={"K3": 6000.0}).interval("nonsense")
