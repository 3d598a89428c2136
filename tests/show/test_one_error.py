"""One number has one error, whatever prints it: D, lam and the threshold speed go through every output."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plain import table_row

import rotorfit as rf
from rotorfit.apps.app.parts import finding_words
from rotorfit.apps.app.results import explains, parameter_table
from rotorfit.apps.study_files.study import Outcome, Study
from rotorfit.identify.fitting.result import FitResult
from rotorfit.show.plots.dynamic_stiffness import _fitted, _shown
from rotorfit.show.plots.style import PLAIN
from rotorfit.show.plots.sweeps import curves
from rotorfit.show.report.write import shares_of

SAME = 1e-6
"""Relative: of slopes by differences; all else is the same arithmetic."""


@pytest.fixture(scope="module")
def fit() -> FitResult:
    return rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": (6000.0, 30.0)})


def mean_speed(fit: FitResult) -> float:
    """At which values that change with speed are those that were fitted."""
    cause = next(cause for cause, _, _ in fit.settings.solved if cause.name == "speed[D]")
    return float(cause.act.mean)


def errors_of_damping(fit: FitResult) -> Iterator[tuple[str, float]]:
    yield "derive", fit.derive(lambda p: p.D, unit="N s/m").stderr
    yield "sum", (fit.params["D"] + 0.0 * fit.params["D"]).stderr
    yield "Cxx", fit.coefficients(mean_speed(fit))["Cxx"].stderr
    yield "table", fit.coefficient_table([mean_speed(fit)]).to_dataframe()["Cxx_stderr"][0]
    yield "covariance of coefficients", np.sqrt(fit.coefficients(mean_speed(fit)).covariance[4, 4])
    yield "covar", np.sqrt(fit.covar[fit.var_names.index("D"), fit.var_names.index("D")])
    yield "budget", fit.budget()["D"].stderr
    yield "shares", np.hypot(*shares_of(fit)["D"])
    yield "data frame", fit.to_dataframe().set_index("parameter").loc["D", "stderr"]
    yield "comparison", rf.compare(fit).to_dataframe()["D_stderr"][0]
    yield "error_of", fit.error_of({"D": 1.0}).stderr


def test_damping_has_one_error(fit: FitResult):
    own = fit.params["D"]
    assert own.stderr == pytest.approx(np.sqrt(own.noise**2 + own.bounded**2 + own.trust**2), rel=SAME)
    for output, error in errors_of_damping(fit):
        assert error == pytest.approx(own.stderr, rel=SAME), output


def test_the_cross_coupling_has_the_error_of_the_product(fit: FitResult):
    speed = mean_speed(fit)
    made = fit.params["D"] * fit.params["lam"] * speed
    found = fit.coefficients(speed)
    for other in (found["Kxy"], fit.derive(lambda p: p.D * p.lam * speed, unit="N/m")):
        assert other.stderr == pytest.approx(made.stderr, rel=SAME)
        assert other.interval() == pytest.approx(made.interval(), rel=SAME)
        assert other.error.largest_on_trust == made.error.largest_on_trust
    assert found.whirl_frequency_ratio.stderr == pytest.approx(fit.params["lam"].stderr, rel=1e-3)  # Mf is left out


def test_away_from_the_mean_speed_coefficients_hold_what_changes_with_speed(fit: FitResult):
    """The same by the sizes: D changes by the share ``speed[D]`` when the speed doubles."""
    speed = 1.5 * mean_speed(fit)
    at = fit.coefficients(speed)["Cxx"]
    D, share = fit.params["D"], 0.5 * fit.causes["speed[D]"].value
    assert at.value == pytest.approx((1 + share) * D.value, rel=SAME)
    made = fit.quantity(at.value, {"D": 1.0, "cause speed[D]": 0.5 * D.value}, "N s/m")  # slopes at no cause
    assert at.stderr == pytest.approx(made.stderr, rel=SAME)
    assert at.stderr != pytest.approx(D.stderr, rel=SAME)


def test_figures_have_the_bands_of_predictions(fit: FitResult):
    """Of a response, and of the stiffness at its force, its inverse: their relative errors are the same."""
    _, every = curves(fit)
    curve = next(c for c in every if c.coordinate == c.force_plane == 1)
    (shown,) = [one for one in _shown(PLAIN, fit) if one.condition == curve.condition]
    line = _fitted(fit, shown, 1, 1, False)
    for frequency, half, factor in (
        (curve.fine, curve.band, 1 / curve.fitted),
        (line.frequency, (line.direct, line.quadrature), line.kappa**2),
    ):
        found = fit.predict(frequency[::20], speed=curve.condition.speed, force_plane="journal", plane="journal")
        by = factor[::20]
        turned = np.array([[by.real, -by.imag], [by.imag, by.real]])
        whole = np.einsum("ikn,nkl,jln->nij", turned, found.covariance + found.systematic, turned)
        expected = 1.96 * np.sqrt(np.einsum("nii->in", whole))
        # Lines are drawn without the causes that were found, predictions with them: that matters where damping counts.
        assert np.median(np.abs(np.array(half)[:, ::20] / expected - 1)) < 0.02


def test_the_threshold_speed_has_one_error(fit: FitResult):
    onset = fit.threshold_speed()
    for other in (fit.threshold_speed(eccentricity=0.0), fit.quantity(onset.value, {"threshold_speed": 1.0}, "rad/s")):
        assert other.value == pytest.approx(onset.value, rel=SAME)
        assert other.stderr == pytest.approx(onset.stderr, rel=SAME)
        assert other.interval() == pytest.approx(onset.interval(), rel=SAME)
    row = fit.budget()["threshold speed"]
    assert row.stderr == pytest.approx(onset.to("rpm").stderr, rel=SAME)
    assert fit.interval("threshold_speed") == pytest.approx(onset.interval(), rel=SAME)


def test_modes_and_natural_frequencies_have_one_error(fit: FitResult):
    """The known K3 and the causes found move both."""
    speed = 1.2 * mean_speed(fit)
    modes = sorted(fit.modes(speed), key=lambda mode: mode.frequency.value)
    pairs = sorted(fit.natural_frequencies(speed), key=lambda pair: pair[0].value)
    for mode, (frequency, ratio, _) in zip(modes, pairs, strict=True):
        for one, other in ((mode.frequency, frequency), (mode.damping_ratio, ratio)):
            assert one.value == pytest.approx(other.value, rel=SAME)
            assert one.stderr == pytest.approx(other.stderr, rel=SAME)


def test_one_group_has_the_errors_of_none(fit: FitResult):
    """Parameters fitted for each value of an attribute that has one value."""
    rig = rf.datasets.rig_lumped()
    one = replace(rig, attributes={"oil": np.full(len(rig), "32")})
    grouped = rf.fit(rf.models.WhirlWhip(), one, known={"K3": (6000.0, 30.0)}, per={"D": "oil"})
    for name, p in grouped.params.items():
        other = fit.params[name.partition("[")[0]]
        assert p.value == pytest.approx(other.value, rel=SAME), name
        assert p.stderr == pytest.approx(other.stderr, rel=SAME), name


def test_tables_print_what_the_parameters_have(fit: FitResult, tmp_path: Path):
    """The summary, the table of a notebook, the front and the report round one error to the same digits."""
    from rotorfit.base.digits import with_error

    own = fit.params["D"]
    _, error = with_error(own.value, own.stderr)
    assert table_row(fit, "D")[2] == error
    assert f"<td>{error}</td>" in fit._repr_html_()
    front = str(parameter_table(fit))
    assert re.search(rf">{re.escape(error)}<", front)
    low, high = (with_error(end, own.stderr)[0] for end in own.interval())
    assert f">{low} to {high}<" in front
    report = rf.write_report(fit, tmp_path / "report.html", figure_format="none").read_text(encoding="utf-8")
    assert re.search(rf">{re.escape(error)}<", report)


def test_a_known_value_with_an_error_is_in_what_is_made_of_it(fit: FitResult):
    """K3 was given within 30: it and a quantity of it alone have what the data leave of that, wherever they stand."""
    row, own = fit.causes["K3"], fit.params["K3"]
    for number in (own, own * 1, fit.derive(lambda p: p.K3, unit="N/m")):
        assert number.stderr == pytest.approx(row.stderr, rel=SAME)
        assert number.trust == pytest.approx(row.stderr, rel=0.01)  # of which the data know next to nothing
    assert str(own) == f"{own.shown()}, known"
    assert table_row(fit, "K3")[2] == own.shown().error == "30"


def judged_alone(fit: rf.FitResult) -> Outcome:
    """What the front has of a fit whose data show no error."""
    study = Study(files=(), model=fit.model.name)
    return Outcome(study=study, experiments=fit.experiments, findings=((),), closed="", fit=fit)


def test_the_front_is_green_of_fits_that_explain_their_data_alone() -> None:
    rig = rf.datasets.rig_open()
    good = rf.fit(rf.models.WhirlWhip(), rig, known={"K3": 6000.0})
    assert explains(judged_alone(good))
    few = rig.select((rig.speed < rig.speed.mean()) & (np.arange(len(rig)) % 3 == 0))
    plain = rf.fit(rf.models.WhirlWhip(), few, known={"K3": 6000.0}, causes=None)
    assert plain.model_limited
    assert not explains(judged_alone(plain))
    wrong = replace(rig, response=np.where(np.arange(len(rig)) == 5, np.nan, rig.response))
    (found,) = [one for one in rf.check(wrong) if one.severity == "error"]
    assert "--undo" in found.words
    assert "--undo" not in str(finding_words(found))
