"""Figures can be read: over planes, speeds and names no two texts overlap, none leaves the canvas; colours differ."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from drawn import faults_of
from plain import plain_fit
from synthetic import circular_test, covering_frequencies

import rotorfit as rf
from rotorfit.show.plots import style

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


@pytest.mark.parametrize("planes", [SHORT[:1], SHORT[:2], LONG[:2], SHORT], ids=["1", "2", "2 long", "3"])
@pytest.mark.parametrize("count", [1, 2, 6])
def test_no_two_texts_overlap_and_none_leaves_the_canvas(planes: tuple[str, ...], count: int) -> None:
    speeds = tuple(np.linspace(60.0, 180.0, count).tolist())
    fit = fit_of(planes, speeds)
    found = {name: faults_of(getattr(fit.plot, name)()) for name in FIGURES}
    assert {name: faults for name, faults in found.items() if faults} == {}


def test_of_five_planes_those_at_forces_and_in_the_fluid_are_drawn() -> None:
    planes = ("a", "b", "c", "d", "e")
    fit = fit_of(planes, (120.0,))
    figure = fit.plot.bode()
    titles = [axis.get_title(loc="left") for axis in figure.axes if axis.get_title(loc="left")]
    at_forces, in_the_fluid = {f"{p}, force at {p}" for p in planes}, {f"e, force at {p}" for p in planes}
    assert set(titles) == at_forces | in_the_fluid
    assert {name: faults_of(one) for name, one in {"bode": figure, "polar": fit.plot.polar()}.items()} == {
        "bode": [],
        "polar": [],
    }
    assert len(fit.plot.bode(every=True).axes) == 2 * 25


def test_the_budget_can_be_read() -> None:
    fit = rf.fit(rf.models.WhirlWhip(), rf.datasets.rig_lumped(), known={"K3": 6000.0})
    assert faults_of(fit.plot.budget()) == []


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
