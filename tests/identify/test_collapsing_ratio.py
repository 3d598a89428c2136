"""A velocity ratio that collapses with eccentricity and speed, and laws of one's own that divide by a parameter."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from plain import plain_fit
from sentences import refuses

import rotorfit as rf
from rotorfit.models.laws import Fluid, Law


class Tanh(Law):
    """A velocity ratio that collapses in another form than the library's, earlier at high speed."""

    name = "tanh"
    parameters = ()

    def at(self, p: Any, eccentricity: Any) -> Fluid:
        return self.at_speed(p, eccentricity, 100.0)

    def at_speed(self, p: Any, eccentricity: Any, speed: Any) -> Fluid:
        wide, edge = 1 - eccentricity**2, 0.85 - 0.0012 * (speed - 60.0)
        ratio = (1 - 0.12 * eccentricity) * (1 - ca.tanh((eccentricity - edge) / 0.08)) / 2
        return Fluid(p.K0 * wide**-1.3, p.D * wide**-1.0, ratio)


def test_a_velocity_ratio_that_collapses_earlier_at_high_speed() -> None:
    """Figs 27 to 29: static loads of journals found by integration in time, of a law that is not the fitted one."""
    true = {"M": 1.2, "K": 2e3, "Ds": 8.0, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}
    known = {"M": 1.2, "K": 2e3, "Ds": 8.0, "Mf": 0.4}
    rig, load = rf.models.OneMode(law=Tanh(), clearance_um=200.0), [0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 5.0, 7.0]
    test = rf.simulate(rig, true, "static-load", speed_rpm=[600, 1200, 1800], load=load, load_deg=-90, noise=0.005)
    fits = {
        law.name: plain_fit(rf.models.OneMode(law=law, clearance_um=200.0), test, known=known)
        for law in (rf.models.Muszynska(), rf.models.Collapse())
    }
    assert fits["muszynska"].redchi > 100
    assert fits["collapse"].redchi < 3
    edges = [0.85 - 0.0012 * (rpm * np.pi / 30 - 60.0) for rpm in (600, 1200, 1800)]
    edge, fall = (fits["collapse"].params[name].value for name in ("edge", "edge_speed"))
    fitted = [edge * np.exp(-fall * (rpm / 1000 - 1)) for rpm in (600, 1200, 1800)]
    np.testing.assert_allclose(fitted, edges, atol=0.02)  # the forms differ by as much
    figure = fits["collapse"].plot.law()
    assert len(figure.legends[0].get_texts()) == 3 + 3  # a curve for each speed, and what is what


class Divides(Law):
    """A law of one's own that divides by its parameter."""

    name = "divides"
    parameters = (rf.models.Parameter("width", "1", "where K0 has doubled", scale=0.8, lower=0.0, upper=3.0),)

    def at(self, p: Any, eccentricity: Any) -> Fluid:
        return Fluid(p.K0 * (1 + (eccentricity / p.width) ** 2), p.D, 1.0)


class FromZero(Divides):
    name = "from-zero"

    def start(self, K0: float, D: float) -> dict[str, float]:
        return {"width": 0.0}


def test_a_law_that_divides_by_its_parameter_begins_at_the_parameters_scale() -> None:
    true = {"M": 1.2, "K": 2e3, "Ds": 8.0, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}
    model = rf.models.OneMode(law=Divides(), clearance_um=200.0)
    test = rf.simulate(
        model, true | {"width": 0.6}, speed_rpm=1200, frequency_rpm=[-900, -500, 300, 600, 900, 1200], force=[0.3, 3.0]
    )
    fit = plain_fit(model, test, known={"Ds": 8.0, "K": 2e3})
    assert abs(fit.params["width"].value - 0.6) < 4 * fit.params["width"].stderr
    with refuses(ValueError):
        plain_fit(rf.models.OneMode(law=FromZero(), clearance_um=200.0), test, known={"Ds": 8.0, "K": 2e3})
