"""Figures can be read: over planes, speeds and names no two texts overlap, none leaves the canvas; colours differ."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
from drawn import faults_of, title_of
from line_tests import ALL, TORSION, VALUES, line_test
from plain import plain_fit
from synthetic import circular_test, covering_frequencies

import rotorfit as rf
from rotorfit.show.plots import style
from rotorfit.show.plots.figure_table import first_figures
from rotorfit.show.plots.run_up_figure import plot_levels, plot_weights

SOURCE = Path(rf.__file__).parent
LONG = ("inboard bearing, drive end", "seal of the balance piston", "outboard bearing, far end")
SHORT = ("fwd", "aft", "mid")
FIGURES = ("dynamic_stiffness", "bode", "polar", "residuals", "stability", "quadrature", "damping", "misfit")


def chain(planes: tuple[str, ...]) -> rf.models.RotorModel:
    return rf.models.Chain(planes=planes, fluid=planes[-1])


def fit_of(planes: tuple[str, ...], speeds: tuple[float, ...]) -> rf.FitResult:
    """A chain of masses in one fluid, forced and read at each."""
    model = chain(planes)
    values = {p.name: 1.0 for p in model.parameters}
    sizes = {"M": 1.0, "K": 2e4, "Ds": 4.0, "K0": 1e4, "D": 400.0, "lam": 0.47, "Mf": 0.3}
    for name in values:
        stem = name.rstrip("0123456789") if name not in sizes else name
        values[name] = sizes[stem]
    theta = model.vector(values)
    w = covering_frequencies(model, theta, speeds, 24)
    known = {name: value for name, value in values.items() if name.startswith(("Ds", "Mf"))}
    return plain_fit(model, circular_test(model, theta, speeds=speeds, frequency=w, noise=0.003), known=known)


@pytest.mark.parametrize(
    ("planes", "count"),
    [(SHORT[:1], 1), (LONG[:1], 6), (LONG[:2], 1), (SHORT[:2], 2), (SHORT[:2], 6), (SHORT, 2), (LONG, 6)],
    ids=["1 plane", "1 long, 6", "2 long", "2, 2 speeds", "2, 6 speeds", "3, 2 speeds", "3 long, 6 speeds"],
)
def test_no_two_texts_overlap_and_none_leaves_the_canvas(planes: tuple[str, ...], count: int) -> None:
    speeds = tuple(np.linspace(60.0, 180.0, count).tolist())
    fit = fit_of(planes, speeds)
    found = {name: faults_of(getattr(fit.plot, name)()) for name in FIGURES}
    assert {name: faults for name, faults in found.items() if faults} == {}


def test_of_four_planes_and_eight_modes_the_first_are_drawn_and_can_be_read() -> None:
    """Responses at forces and in the fluid, the diagonal of the stiffness, residuals by probe; ``every`` draws all."""
    planes = (*LONG, "coupling, motor end")
    fit = fit_of(planes, (120.0,))
    names = ("dynamic_stiffness", "bode", "residuals", "stability", "damping")
    drawn = {name: getattr(fit.plot, name)() for name in names}
    drawn["polar"] = fit.plot.polar(every=True)
    assert {name: faults for name, one in drawn.items() if (faults := faults_of(one))} == {}
    titles = {name: {title_of(axis).replace("\n", " ") for axis in one.axes} - {""} for name, one in drawn.items()}
    at_forces = {f"{plane}, force at {plane}" for plane in planes}
    assert titles["bode"] == at_forces | {f"{planes[-1]}, force at {plane}" for plane in planes}
    assert sum(", direct" in title for title in titles["dynamic_stiffness"]) == 4
    assert (titles["residuals"], len(titles["polar"])) == (set(planes), 16)
    assert "4F" in [text.get_text() for text in drawn["damping"].axes[0].texts]


def test_figures_of_balancing_campaigns_judging_and_plans_can_be_read() -> None:
    test = rf.read(rf.datasets.path("field_balance.csv"), constants={"sigma_mil_pp": "0.02"})
    found = rf.balance(rf.influence(test), "trial 2", holes=24)
    drawn = {"vibration": found.plot(), "levels": plot_levels(found), "weights": plot_weights(found)}
    runs = rf.campaign(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), split="speed_rpm", known={"K3": 6000.0})
    rig = rf.datasets.rig_lumped()
    fit = plain_fit(rf.models.WhirlWhip(), rig, known={"K3": 6000.0})
    drawn["judged"] = fit.stability_report(max_speed_rpm=2500).plot()
    drawn |= {"size": fit.plot.bode(against="size"), "drive": fit.plot.drive_point(), "polar": rig.plot.polar()}
    drawn["plan"] = rf.plan(fit.model, fit, rig, noise_um=0.2, quantity="lam").plot()
    lines = {line.get_label().split()[0]: line.get_linestyle() for line in drawn["judged"].axes[0].lines}
    assert (lines["forward"], lines["backward"]) == ("-", "--")
    drawn["trends"] = runs.plot.trends(["K0", "D", "lam"], against="speed_rpm")
    assert {name: faults for name, one in drawn.items() if (faults := faults_of(one))} == {}


def test_figures_of_uneven_shafts_can_be_read() -> None:
    model = rf.models.AnisotropicShaft()
    fit = plain_fit(model, line_test(model, VALUES | TORSION, ALL, np.random.default_rng(3), steady=("1x", "2x")))
    drawn = {name: getattr(fit.plot, name)() for name in ("lines", "line", "growth", "line_misfit", "stability")}
    assert {name: faults for name, one in drawn.items() if (faults := faults_of(one))} == {}
    assert first_figures(fit, good=True)[0] == first_figures(fit, good=False)[0]
    assert "The shaft is not round: its stiffness varies by" in fit.summary()


def test_modes_of_a_first_screen_are_those_in_the_tested_band_each_with_its_name() -> None:
    """Six modes of a known shaft beyond the band are left out; one whose damping leaves the panel is named there."""
    masses, springs = np.full(6, 0.4), np.full(7, 6e4)
    stiffness = np.diag(springs[:-1] + springs[1:]) - np.diag(springs[1:-1], 1) - np.diag(springs[1:-1], -1)
    planes = {"disk": 1, "seal": 4}
    model = rf.models.KnownStructure(
        np.diag(masses), None, None, stiffness, planes=planes, fluid="seal", damping="disk", dofs=("z",)
    )
    theta = model.vector({"Ds": 5.0, "K0": 1e4, "D": 400.0, "lam": 0.47, "Mf": 0.3})
    half = np.linspace(20.0, 200.0, 12)
    test = circular_test(model, theta, speeds=(250.0,), frequency=np.r_[-half[::-1], half], noise=0.003)
    figure = plain_fit(model, test).plot.damping()
    named = {text.get_text() for text in figure.axes[0].texts}
    assert "1F" in named
    assert not {"4F", "5F", "6F", "4B", "5B", "6B"} & named
    assert faults_of(figure) == []
    model = rf.models.OneMode()
    theta = model.vector({"M": 1.2, "K": 2e3, "Ds": 8.0, "K0": 9e3, "D": 60.0, "lam": 0.46, "Mf": 0.4})
    sweep = np.r_[-np.linspace(40.0, 170.0, 12)[::-1], np.linspace(40.0, 170.0, 12)]
    test = circular_test(model, theta, speeds=(30.0, 60.0), frequency=sweep, noise=0.003)
    leaving = plain_fit(model, test, known={"M": 1.2, "K": 2e3, "Ds": 8.0}).plot.damping()
    assert {"1F", "1B"} < {text.get_text() for text in leaving.axes[0].texts}
    assert faults_of(leaving) == []


def test_the_budget_can_be_read() -> None:
    fit = rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": 6000.0})
    assert faults_of(fit.plot.budget()) == []


def test_colours_stand_in_one_place() -> None:
    literal = re.compile(r"""colors?["=:]+ ?["'](?!white|none|")|["']C\d["']|["']#[0-9A-Fa-f]{6}["']""")
    drawing = [*(SOURCE / "show" / "plots").glob("*.py"), *(SOURCE / "studies").rglob("*figure*.py")]
    lines = [(file.name, line) for file in drawing if file.name != "style.py" for line in file.read_text().splitlines()]
    assert [one for one in lines if literal.search(one[1])] == []


def lab(colour: str, matrix: np.ndarray) -> np.ndarray:
    """CIELAB of a colour as an eye sees it; D65."""
    level = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
    linear = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
    seen = np.clip(matrix @ linear, 0.0, 1.0)
    to_xyz = np.array(
        [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
    )
    x, y, z = (to_xyz @ seen) / (0.95047, 1.0, 1.08883)
    f = [np.cbrt(t) if t > (6 / 29) ** 3 else t / (3 * (6 / 29) ** 2) + 4 / 29 for t in (x, y, z)]
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


EYES = {  # Machado, Oliveira and Fernandes 2009, severity 1, of linear RGB
    "normal": np.eye(3),
    "protan": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deutan": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritan": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


@pytest.mark.parametrize("eye", EYES)
@pytest.mark.parametrize(
    ("colours", "least"),
    [(style.COLOURS, 17), (style.RAMP, 22), (style.FORWARD, 13), (style.BACKWARD, 14), (style.SHARES, 26)],
)
def test_colours_of_a_set_are_told_apart_by_every_eye(eye: str, colours: tuple[str, ...], least: float) -> None:
    seen = [lab(colour, np.asarray(EYES[eye])) for colour in colours]
    assert min(np.linalg.norm(a - b) for a, b in itertools.combinations(seen, 2)) >= least - 0.5  # as rounded


def test_text_has_contrast_and_the_first_two_conditions_differ_in_grey() -> None:
    def luminance(colour: str) -> float:
        level = np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)]) / 255
        linear = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
        return float(linear @ (0.2126, 0.7152, 0.0722))

    for colour in (style.INK, style.GREY, style.CRITICAL):
        assert 1.05 / (luminance(colour) + 0.05) >= 4.5  # WCAG AA
    lightness = [lab(colour, np.eye(3))[0] for colour in style.COLOURS[:2]]
    assert abs(lightness[0] - lightness[1]) > 30
