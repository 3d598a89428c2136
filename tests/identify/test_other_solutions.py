"""Solutions that data hold alike are found by the data, not by the class of the model."""

from __future__ import annotations

import numpy as np
import pytest

import rotorfit as rf
from rotorfit.models import Chain, Overhung, Parameter, RotorModel

W = np.r_[-400:-20:5.0, 20:401:5.0]
CHAIN = {"M1": 2.0, "M2": 2.0, "K1": 4e4, "K2": 9e4, "K3": 7e4, "Ds1": 20.0, "Ds2": 50.0}
EQUAL = {"M1": 2.0, "M2": 2.0}


def swept(kappa, read: dict[str, int], force: tuple[str, int], speed: float = 0.0, axes: str = "z"):
    """Responses to a force of 20 N of a dynamic stiffness that is written down here."""
    rng, sigma = np.random.default_rng(1), 2e-8
    load = np.eye(2)[force[1]] * 20.0
    motion = np.array([np.linalg.solve(kappa(w), load) for w in W])
    response = np.concatenate([motion[:, k] for k in read.values()])
    noise = sigma * (rng.normal(size=response.size) + 1j * rng.normal(size=response.size))
    return rf.perturbation_test(
        run="sweep", speed=speed, frequency=np.tile(W, len(read)), force_plane=force[0], force=20.0,
        plane=np.repeat(list(read), W.size), direction=axes, response=response + noise, sigma=sigma,
    )  # fmt: skip


def chain(w: float) -> np.ndarray:
    return np.array([[1.3e5 + 20j * w - 2 * w**2, -9e4], [-9e4, 1.6e5 + 50j * w - 2 * w**2]])


def overhung(w: float) -> np.ndarray:
    tilt = 1.2e4 + 0.5j * w + 0.18 * 200 * w - 0.1 * w**2
    return np.array([[2e5 + 30j * w - 5 * w**2, -3e4], [-3e4, tilt]])


class Bracket(RotorModel):
    """Two coordinates under names of the user's own."""

    name = "bracket"
    planes = ("near", "far")
    parameters = (
        Parameter("heavy", "kg", "mass, known alike for both"),
        *(Parameter(f"{what}_{where}", "N/m" if what == "stiff" else "N s/m", what, scale)
          for what, scale in (("stiff", 5e4), ("loss", 20.0)) for where in ("near", "far")),
        Parameter("link", "N/m", "coupling", 5e4),
    )  # fmt: skip

    def equation(self, p, speed, eccentricity):
        stiffness = [[p.stiff_near + p.link, -p.link], [-p.link, p.stiff_far + p.link]]
        return stiffness, [[p.loss_near, 0], [0, p.loss_far]], [[p.heavy, 0], [0, p.heavy]]


@pytest.mark.parametrize(
    ("model", "known", "first"), [(Chain(2), EQUAL, "K1"), (Bracket(), {"heavy": 2.0}, "stiff_near")]
)
def test_force_at_one_mass_and_response_at_the_other(model, known, first) -> None:
    planes = model.planes
    fit = rf.fit(model, swept(chain, {planes[1]: 1}, (planes[0], 0)), known=known, causes=None)
    (other,) = fit.other_solutions
    both = sorted([fit.params[first].value, other.values[first]])
    np.testing.assert_allclose(both, [4e4, 7e4], rtol=1e-3)  # the truth and its mirror
    again = rf.fit(model, fit.experiments, known=known, causes=None, start=dict(other.values))
    assert again.chisqr == pytest.approx(fit.chisqr, rel=1e-9)
    assert again.params[first].value == pytest.approx(other.values[first], rel=1e-6)
    assert "exchanged" in fit.summary()
    assert "no draw is of it" in fit.sample(seed=1, ess=200).treatment
    # readings at both masses tell them apart
    whole = rf.fit(model, swept(chain, {planes[0]: 0, planes[1]: 1}, (planes[0], 0)), known=known, causes=None)
    assert whole.other_solutions == ()


def test_the_sign_of_a_coupling_that_only_its_square_tells() -> None:
    alone = rf.fit(Overhung(), swept(overhung, {"disk": 0}, ("disk", 0), 200.0), known={"It": 0.1}, causes=None)
    (other,) = alone.other_solutions
    assert other.values["k12"] == -alone.params["k12"].value
    assert abs(other.values["k12"]) == pytest.approx(3e4, rel=1e-3)
    assert "k12 of the other sign" in alone.summary()
    # a bound chooses
    chosen = rf.fit(Overhung(), alone.experiments, known={"It": 0.1}, bounds={"k12": (None, 0.0)}, causes=None)
    assert chosen.other_solutions == ()
    assert chosen.params["k12"].value == pytest.approx(-3e4, rel=1e-3)


def test_values_that_may_be_zero_have_no_other_sign() -> None:
    fit = rf.fit(Chain(2), swept(chain, {"mass-1": 0, "mass-2": 1}, ("mass-1", 0)), causes=None)
    assert fit.other_solutions == ()
