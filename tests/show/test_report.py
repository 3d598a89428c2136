"""The report: complete, self-contained, safe against names in the data, whole or absent."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import law_data
import numpy as np
import pytest
from report_pages import Page, made_profile, normal_draws, report_of
from seal_rig import FLUID, floating_stator
from sentences import refuses
from slow_cases import slow_but
from synthetic import (
    KNOWN,
    MODELS,
    SPEEDS,
    TYPICAL,
    circular_test,
    covering_frequencies,
    known_of,
    overhung_without_slopes,
    random_stable_rigs,
)

import rotorfit as rf
from rotorfit.identify.fitting.result import FitResult
from rotorfit.lab.data.findings import Finding
from rotorfit.show.report.interactive import interactive_section
from rotorfit.show.report.numbers import with_error
from rotorfit.show.report.page import SECTIONS, VERDICT
from rotorfit.show.report.write import document

RPM = 30 / np.pi
HOSTILE = '<script>alert(1)</script>&"$x_{'


def perturbed() -> rf.PerturbationTest:
    rig = rf.datasets.rig_open()
    assert isinstance(rig, rf.PerturbationTest)
    return rig


# ---- content ------------------------------------------------------------------------------------


@pytest.mark.usefixtures("sketched")
def test_report_of_the_rig_says_what_the_fit_says(rig_fit: FitResult, tmp_path: Path) -> None:
    page = report_of(rig_fit, tmp_path / "report.html")
    onset = rig_fit.threshold_speed()
    assert f"{onset.value * RPM:.1f} ± {onset.stderr * RPM:.1f} rpm" in page.shown
    assert "above the highest tested speed (extrapolated)." in page.shown
    assert f"{100 * (onset.value / rig_fit.speeds.max() - 1):.0f} % above the highest tested speed" in page.shown
    assert "fit agrees with the noise" in page.shown
    for row in rig_fit.causes.found:
        assert row.words.partition(":")[0] in page.shown
    for title in (
        "Parameters", "Error budget", "95 % intervals", "Identifiability", "Test and data", "Model",
        "Dynamic stiffness", "Bode plots", "Polar plots", "Residuals", "Quality of fit", "Stability", "To reproduce",
    ):  # fmt: skip
        assert f"<h2>{title}</h2>" in page.text
    assert page.tags.count("img") == 8
    for p in rig_fit.params.values():
        assert p.meaning in page.shown
        if p.vary:
            digits = 1 - int(np.floor(np.log10(p.stderr)))
            assert f"{round(p.value, digits):.{max(digits, 0)}f}"[:5] in page.shown
    for r in rig_fit.responses:
        assert r.name in page.shown
    assert "rotorfit fit rig_open.csv --model whirl-whip --known K3=6000 --out results/" in page.shown
    for package in ("casadi", "numpy", "scipy", "matplotlib"):
        assert re.search(rf"\b{package} \d", page.shown)


@pytest.mark.slow
@pytest.mark.usefixtures("sketched")
def test_the_python_call_gives_the_same_numbers(
    rig_refinement: rf.Refinement, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(rf.datasets.path("rig_open.csv").parent)
    page = report_of(rig_refinement.best, tmp_path / "report.html", refinement=rig_refinement)
    (call,) = re.findall(r"import rotorfit as rf\n.*?(?=</pre>)", page.text, re.DOTALL)
    names: dict[str, Any] = {}
    exec(Page(call).words[0], names)
    # Two descents to one optimum, each to a small fraction of the standard errors.
    assert (np.abs(names["fit"].x - rig_refinement.best.x) < 1e-2 * np.sqrt(np.diag(rig_refinement.best.covar))).all()
    assert names["fit"].var_names == rig_refinement.best.var_names


@pytest.mark.usefixtures("sketched")
def test_refined_report_with_all_extras(rig_refinement: rf.Refinement, tmp_path: Path) -> None:
    best = rig_refinement.best
    posterior = normal_draws(best)
    page = report_of(
        best,
        tmp_path / "report.html",
        refinement=rig_refinement,
        posterior=posterior,
        profiles=[made_profile("lam", 0.4749, 0.4752), made_profile("threshold_speed", 277.0, 279.0)],
        shares={"D": (0.1, 4.5)},
        operating_speed_rpm=2800,
        title="Seal rig, run 7",
    )
    assert page.text.count("Seal rig, run 7") == 2  # title and heading
    assert "below the operating speed (2800 rpm)" in page.shown
    assert "fit agrees with the noise" in page.shown
    refinement = page.text.partition("<h2>Structural refinement</h2>")[2].partition("</section>")[0]
    assert refinement.count("<td>chosen</td>") == 1
    assert "not of the chosen" not in refinement
    assert "[0.474900, 0.475200]" in page.shown
    low, high = np.quantile(posterior.samples[:, best.var_names.index("D")], [0.025, 0.975])
    intervals = page.text.partition("<h2>95 % intervals</h2>")[2]
    (row,) = [row for row in intervals.split("</section>")[0].split("<tr>") if "<code>D</code>" in row]
    _, *shown = re.findall(r"\[([0-9.]+), ([0-9.]+)\]", row)
    assert [float(end) for end in shown[0]] == pytest.approx([low, high], abs=0.05 * (high - low))
    assert "causes beside the model (type B)" in page.shown
    assert f"[{277 * RPM:.1f}, {279 * RPM:.1f}]" in page.shown
    for words in (
        "split R-hat",
        "bulk ESS",
        "tail ESS",
        "50 % of the proposals accepted",
        "converged: made for a test",
    ):
        assert words in page.shown.replace("Converged", "converged")
    assert "Profile likelihoods" in page.shown
    assert page.tags.count("img") == 12
    parameters = page.text.partition("<h2>Parameters</h2>")[2].partition("</section>")[0]
    assert "kg s²" in parameters
    assert "s^" not in parameters
    assert (
        "--known K3=6000 --refine --profile lam,threshold_speed --sample --seed 5 --ess 4000 --max-steps 1000 --out"
        in page.shown
    )


@pytest.mark.slow
@pytest.mark.usefixtures("sketched")
def test_a_posterior_that_did_not_converge_is_said_at_the_top(rig_fit: FitResult, tmp_path: Path) -> None:
    page = report_of(
        rig_fit, tmp_path / "r.html", posterior=normal_draws(rig_fit, converged=False, message="too short")
    )
    assert "too short" in page.text.partition("<h2>Parameters")[0]


@pytest.mark.usefixtures("sketched")
def test_the_verdict_says_what_may_be_a_local_minimum(tmp_path: Path) -> None:
    """As tests/identify/test_starts.py holds of the fit: an overhung rotor whose slopes nobody read."""
    fit = rf.fit(MODELS["overhung"](), overhung_without_slopes(random_stable_rigs("overhung", 10, seed=13)[9], seed=9))
    (doubt,) = (warning for warning in fit.warnings if "perhaps a local minimum" in warning)
    page = report_of(fit, tmp_path / "report.html")
    first, _, below = page.shown.partition("95 %:")
    assert "may have ended in a local minimum" in first
    assert "agrees with the noise" not in first  # though redchi is 1.2
    # a sentence of the list of warnings begins with a capital
    assert doubt.removeprefix("perhaps") in below.partition("standard error")[0]


@pytest.mark.usefixtures("sketched")
def test_what_the_data_leave_open_has_no_number(tmp_path: Path) -> None:
    rig = perturbed()
    fit = rf.fit(rf.models.WhirlWhip(), rig.select(rig.force_plane == "journal"), known={"K3": 6000.0})
    page = report_of(fit, tmp_path / "report.html")
    assert {"Md", "Ds", "K1", "sigma", "K0"} == set(fit.identifiability.unresolved)
    for name in fit.identifiability.unresolved:
        (row,) = [r for r in page.text.split("<tr>") if f"<code>{name}</code>" in r and fit.params[name].meaning in r]
        assert "not determined" in row
    assert "5 of 10 values open" in page.shown
    assert "fix sigma" in page.shown


@pytest.mark.usefixtures("sketched")
def test_the_verdict_tells_the_misfit_of_the_responses(
    rig_fit: FitResult, rig_refinement: rf.Refinement, tmp_path: Path
) -> None:
    """The words, the span of the responses and what is said of the noise agree with each other."""
    for name in ("refined", "plain"):
        (tmp_path / name).mkdir()
    refined = report_of(rig_refinement.best, tmp_path / "refined" / "report.html", refinement=rig_refinement).text
    sizes = sorted(r.redchi for r in rig_refinement.best.responses)
    assert f"by response {sizes[0]:.2g} to {sizes[-1]:.2g}" in refined
    assert "never from the residuals" not in refined
    assert ("follow the residuals of each response instead" in refined) == bool(
        rig_refinement.best.settings.noise_scale
    )
    assert "the residuals of the fit have no part in it" in report_of(rig_fit, tmp_path / "plain" / "report.html").text
    # one threshold: that of the chosen row is that of the verdict
    value = f"{rig_refinement.best.threshold_speed().value * 30 / np.pi:.0f}"
    assert refined.count(value) >= 3


@pytest.mark.usefixtures("sketched")
def test_a_failed_fit_says_so_first(tmp_path: Path) -> None:
    start = {"K1": 100.0, "K2": 100.0, "Md": 0.1, "Mb": 5.0, "D": 1.0}
    fit = rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0}, start=start, max_iterations=1)
    assert not fit.success
    page = report_of(fit, tmp_path / "report.html")
    assert "did not converge: no number here can be relied on" in page.shown
    assert "not-good" in page.text
    assert "<b>" not in page.text.partition('class="headline"')[2].partition("</p>")[0]  # no number in bold
    assert "max_iterations=1)" in page.shown
    assert "--max-iterations 1" in page.shown


@pytest.mark.parametrize("name", sorted(MODELS))
@pytest.mark.usefixtures("sketched")
def test_every_model_has_a_report(name: str, tmp_path: Path) -> None:
    model = MODELS[name]()
    theta = model.vector(TYPICAL[name])
    w = covering_frequencies(model, theta, SPEEDS[name], 60)
    test = circular_test(model, theta, speeds=SPEEDS[name], frequency=w, noise=0.01, seed=2)
    fit = rf.fit(model, test, known=known_of(name, TYPICAL[name]))
    assert fit.success
    page = report_of(fit, tmp_path / "report.html")
    assert name in page.shown
    assert ("Bokeh.documents" in interactive_section(fit)) == (name != "anisotropic-shaft")
    for known in KNOWN[name]:
        assert f"{known}=" in page.shown
    assert "κ" in page.shown


@pytest.mark.usefixtures("sketched")
def test_groups_may_be_named_by_any_words(tmp_path: Path) -> None:
    rig = rf.datasets.rig_open()
    inlet = np.where(rig.speed < np.median(rig.speed), "radial, 4 bar", "anti-swirl, p=5")
    test = replace(rig, attributes={**rig.attributes, "inlet": inlet})
    fit = rf.fit(rf.models.WhirlWhip(), test, known={"K3": 6000.0}, per={"lam": "inlet"})
    page = report_of(fit, tmp_path / "report.html")
    for name in ("inlet=radial, 4 bar", "inlet=anti-swirl, p=5"):
        assert f"Threshold of instability, {name}" in page.shown


@pytest.mark.usefixtures("sketched")
def test_groups_outliers_priors_and_closed_form(tmp_path: Path) -> None:
    from scipy import stats

    rig = rf.datasets.rig_open()
    fit = rf.fit(
        rf.models.WhirlWhip(), rig, known={"K3": 6000.0}, per={"D": "speed_rpm"}, loss="huber",
        priors={"sigma": stats.norm(1.0, 0.01)}, bounds={"lam": (0.0, 0.6)}, start={"D": 300.0}, phase_offsets=True,
    )  # fmt: skip
    page = report_of(fit, tmp_path / "report.html")
    assert "Threshold of instability, speed_rpm=1000" in page.shown
    assert "D[speed_rpm=2000]" in page.shown
    assert "outliers weigh little (huber loss)" in page.shown
    words = "--known K3=6000 --bounds lam=0:0.6 --prior sigma=1:0.01 --start D=300 --per D=speed_rpm"
    assert f"{words} --loss huber --phase-offsets" in page.shown
    assert "start={'D': 300.0}" in page.shown
    closed = rf.closed_form(rf.models.WhirlWhip(), rig, known={"K3": 6000.0})
    page = report_of(closed, tmp_path / "report.html")
    assert "fit = rf.closed_form(model, experiments, known={'K3': 6000.0}" in page.shown
    assert "rotorfit fit" not in page.shown


@pytest.mark.usefixtures("sketched")
def test_two_disk_report_knows_no_speed(tmp_path: Path) -> None:
    test = rf.read(rf.datasets.path("two_disk.csv"))
    fit = rf.fit(rf.models.TwoDisk(), test)
    page = report_of(fit, tmp_path / "report.html")
    assert "does not depend on the rotative speed" in page.shown


@pytest.mark.usefixtures("sketched")
def test_a_calibration_brings_its_budget(tmp_path: Path) -> None:
    calibration = rf.Calibration(probe_gain=0.01, mr=0.005, keyphasor_deg=0.5)
    fit = rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_open(), known={"K3": 6000.0}, calibration=calibration)
    page = report_of(fit, tmp_path / "report.html")
    budget = page.text.partition("<h2>Error budget</h2>")[2].partition("</section>")[0]
    whole, entries, correlations = (part.partition("</table>")[0] for part in budget.split("<table")[1:])
    (row,) = [row for row in whole.split("<tr>") if "<code>D</code>" in row]
    _, combined, noise, bounded, trust, coverage = (float(n) for n in re.findall(r'number">([0-9.]+)<', row)[:6])
    # each number has two digits
    assert combined == pytest.approx(fit.params["D"].stderr, rel=0.05)
    assert np.linalg.norm([noise, bounded, trust]) == pytest.approx(combined, rel=0.05)
    assert coverage == pytest.approx(1.96, abs=0.005)
    # D is a force over the journal's motion: the mean of its two probes, 1 % each, and half a percent of the force
    own = [row for row in entries.split("<tr>") if "<code>D</code>" in row]
    shares = [float(re.findall(r'number">([0-9.-]+)<', row)[-1]) for row in own if "gain" in row]
    assert np.linalg.norm(shares) == pytest.approx(np.hypot(0.01 / np.sqrt(2), 0.005) * fit.params["D"].value, rel=0.05)
    for words in ("gain[journal]", "type B", "+1.00"):
        assert words in budget
    assert correlations.count("+1.00") >= len(fit.budget().rows)
    call = "--calibration probe_gain=0.01 --calibration mr=0.005 --calibration keyphasor_deg=0.5"
    assert call in page.shown


def law_model() -> rf.models.OneMode:
    return rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=law_data.CLEARANCE_UM)


KNOWN_ONE_MODE = {"K": 8000.0, "Ds": 8.0}


@pytest.mark.usefixtures("sketched")
@pytest.mark.parametrize("kind", slow_but(["sweep", "static", "impulse", "linear static", "joint"], "sweep", "joint"))
def test_every_kind_of_experiment_has_a_report(kind: str, tmp_path: Path) -> None:
    values = law_data.ONE_MODE
    sweep, static = law_data.sweep(values, levels=(2.0, 10.0, 20.0)), law_data.static(values)
    impulse = law_data.impulse(law_data.LIGHT)
    small = [law_data.sweep(values, levels=(0.2,)), law_data.static(values, loads=(0.2, 0.3, 0.4, 0.5))]
    given: dict[str, Any] = {
        "sweep": (law_model(), sweep, {}),
        "static": (law_model(), static, {"M": 1.2, "Mf": 0.4}),
        "impulse": (law_model(), impulse, {}),
        "linear static": (rf.models.OneMode(), small, {}),
        "joint": (law_model(), [sweep, static, law_data.impulse(values)], {}),
    }
    model, experiments, known = given[kind]
    fit = rf.fit(model, experiments, known={**KNOWN_ONE_MODE, **known})
    page = report_of(fit, tmp_path / "report.html")
    for experiment in fit.experiments:
        assert experiment.title in page.shown
    assert ("Bokeh.documents" in interactive_section(fit)) == any(
        isinstance(e, rf.PerturbationTest) for e in fit.experiments
    )
    assert "Not finite" not in page.shown
    assert ("muszynska law: K0 (1 - eps^2)^-n_K" in page.shown) == model.eccentricity_dependent
    assert "log1p" not in page.shown
    assert f"highest tested speed ({max(e.speed.max() for e in fit.experiments) * RPM:.0f} rpm)" in page.shown


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (450.2312, 0.1134, ("450.23", "0.11")),
        (14150.6, 112.0, ("14150", "110")),
        (-1.43e-15, 0.005, ("0.0000", "0.0050")),
        (-5.7e-5, 2.4e-4, ("−0.00006", "0.00024")),
        (-9.8e-9, 5.1e-9, ("−9.8·10⁻⁹", "5.1·10⁻⁹")),
        (2.5e8, 3.1e6, ("2.500·10⁸", "0.031·10⁸")),
        (0.0, 1.5e-6, ("0.0·10⁻⁶", "1.5·10⁻⁶")),
        (3.25, np.inf, ("3.25", "–")),
    ],
)
def test_numbers_end_with_the_second_digit_of_their_error(value: float, error: float, shown: tuple[str, str]) -> None:
    assert with_error(value, error) == shown


# ---- text from data files -------------------------------------------------------------------------


@pytest.mark.usefixtures("sketched")
def test_a_report_leads_to_pages_that_explain_it_where_the_site_is(
    rig_fit: FitResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    docs = Path(__file__).parents[2] / "docs"
    for page in {*SECTIONS.values(), *VERDICT.values()}:
        name, _, anchor = page.partition("#")
        stem = name.removesuffix(".html")
        source = docs / (f"{stem}.md" if not stem.startswith("_gallery/") else f"paper/{stem[9:]}.py")
        text = source.read_text(encoding="utf-8")
        headings = {re.sub(r"[^\w]+", "-", line[3:].lower()) for line in text.splitlines() if line.startswith("## ")}
        assert not anchor or f"({anchor})=" in text or anchor in headings, page
    monkeypatch.setenv("ROTORFIT_DOCS", str(tmp_path))  # nothing is built there
    assert "explained" not in Page(write(rig_fit, tmp_path)).shown
    monkeypatch.setenv("ROTORFIT_DOCS", "https://docs.example.org/rotorfit")
    page = Page(write(rig_fit, tmp_path))
    links = [value for tag, key, value in page.attributes if (tag, key) == ("a", "href") and value[0] != "#"]
    assert {link.removeprefix("https://docs.example.org/rotorfit/") for link in links} <= {
        *SECTIONS.values(),
        *VERDICT.values(),
    }
    assert sum("faq-redchi" in link for link in links) == 3  # of the verdict, the residuals and the quality of fit
    headings = re.findall(r"<h2>([^<]*?)(?: <a|</h2>)", page.text)
    assert [title for title in headings if title not in SECTIONS] == ["To reproduce"]


def write(fit: FitResult, folder: Path) -> str:
    """The text of a report."""
    return rf.write_report(fit, folder / "report.html").read_text(encoding="utf-8")


def test_names_from_files_stay_text(tmp_path: Path) -> None:
    rig = perturbed()
    renamed = replace(
        rig,
        source=HOSTILE,
        run=np.char.add(rig.run, HOSTILE),
        plane=np.where(rig.plane == "disk", HOSTILE, "journal"),
        force_plane=np.where(rig.force_plane == "disk", HOSTILE, "journal"),
    )
    fit = rf.fit(rf.models.WhirlWhip(planes=(HOSTILE, "journal")), renamed, known={"K3": 6000.0})
    finding = Finding("error", "made-up", f"row of {HOSTILE}")
    page = report_of(fit, tmp_path / "report.html", findings=[[finding]], title=HOSTILE)
    assert "<script" not in page.text
    assert page.shown.count(HOSTILE) > 20
    assert "<title>&lt;script&gt;alert(1)&lt;/script&gt;&amp;&quot;$x_{</title>" in page.text
    assert HOSTILE not in interactive_section(fit)


# ---- whole or not at all ------------------------------------------------------------------------


@pytest.mark.usefixtures("sketched")
def test_an_old_report_survives_a_failure(rig_fit: FitResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "report.html"
    path.write_text("old", encoding="utf-8")

    def full(self: Path, content: bytes) -> int:
        with self.open("wb") as stream:
            stream.write(content[:100])
        raise OSError(28, "No space left on device", str(self))

    monkeypatch.setattr(Path, "write_bytes", full)
    with refuses(OSError):
        rf.write_report(rig_fit, path)
    monkeypatch.undo()
    assert path.read_text(encoding="utf-8") == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.usefixtures("sketched")
def test_a_path_that_cannot_be_written(rig_fit: FitResult, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        rf.write_report(rig_fit, tmp_path / "absent" / "report.html")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"profiles": [made_profile("lamda", 0, 1)]}, "profiles: the fit has no lamda; it has Md, "),
        ({"profiles": [made_profile("lam", 0, 1, 0.9)]}, "its level is 0.9, the report's intervals are at 0.95"),
        ({"shares": {"lamda": (0, 1)}}, "shares: the fit has no lamda"),
        ({"findings": [[], []]}, "findings of 2 experiments, but the fit has 1"),
    ],
)
def test_material_that_does_not_go_together(
    rig_fit: FitResult, tmp_path: Path, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        rf.write_report(rig_fit, tmp_path / "report.html", **options)
    assert list(tmp_path.iterdir()) == []


def test_a_posterior_of_something_else(rig_fit: FitResult, rig_refinement: rf.Refinement, tmp_path: Path) -> None:
    with refuses(ValueError):
        rf.write_report(rig_fit, tmp_path / "report.html", posterior=normal_draws(rig_refinement.best))


@pytest.mark.usefixtures("sketched")
def test_document_is_deterministic_but_for_its_date(rig_fit: FitResult) -> None:
    from rotorfit.show.report.material import ReportInput

    material = ReportInput(fit=rig_fit, findings=[[]])
    first, second = (re.sub(r"\d{4}-\d\d-\d\d \d\d:\d\d", "", document(material, "title")) for _ in range(2))
    assert first == second
    assert io.StringIO(first).readline().strip() == "<!DOCTYPE html>"


@pytest.mark.usefixtures("sketched")
def test_warnings_of_the_data_stand_in_the_verdict(tmp_path: Path) -> None:
    """A probe that reads a quarter too much leaves the misfit as it is, and makes every stiffness wrong."""
    rig = rf.datasets.rig_lumped()
    wrong = (rig.plane == "disk") & (rig.direction == "y")
    test = replace(rig, response=np.where(wrong, 1.25, 1.0) * rig.response)
    fit = rf.fit(rf.models.WhirlWhip(), test, known={"K3": 6000.0})
    page = report_of(fit, tmp_path / "report.html")
    assert "reads 1.25 times" in page.text.partition("<h2>Dynamic stiffness")[0]


def test_a_dry_run_is_no_weight(tmp_path: Path) -> None:
    """The report of a seal says nothing of weights, nor of the stability of a stator without a rotor."""
    wet, dry = (
        rf.read(floating_stator(speeds_rpm=[rpm], fluid=fluid, motion_noise=0.1, sigma_um=0.1, force_sigma=0.1))
        for rpm, fluid in ((3000.0, FLUID), (0.0, None))
    )
    fit = rf.fit(rf.models.Anisotropic(("stator",)), wet, baseline=dry)
    page = report_of(fit, tmp_path / "report.html", figure_format="none")
    assert "weights" not in page.text.lower()
    assert "Threshold of instability" not in page.text
