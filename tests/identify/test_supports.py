"""Unknown supports of a known shaft, from tests at rest and in rotation at once."""

from __future__ import annotations

import numpy as np
import pytest
from plain import plain_fit
from sentences import refuses
from supported_shaft import FLUID, SUPPORTS, along_axes, at_rest, matrices, model, rotating

import rotorfit as rf


@pytest.fixture(scope="module")
def fit():
    rng = np.random.default_rng(1)
    return plain_fit(model(), [at_rest(rng, lines=120), rotating(rng, lines=60)])


def test_orthotropic_supports_and_the_fluid_together(fit):
    """Stiffness within 1 %, damping within 5 %, all within four errors."""
    assert fit.success
    assert 0.9 < fit.redchi < 1.1
    for name, (quantity, truth) in along_axes(fit).items():
        assert quantity.value == pytest.approx(truth, rel=0.01 if name.startswith("k") else 0.05), name
        assert abs(quantity.value - truth) < 4 * quantity.stderr, name
    for name, truth in FLUID.items():
        assert abs(fit.params[name].value - truth) < 4 * fit.params[name].stderr, name


def test_a_test_at_rest_along_x_alone_gives_the_supports_along_x():
    """With supports taken for round; what differs along y cannot be asked of it, and is refused."""
    rng = np.random.default_rng(2)
    test = at_rest(rng, lines=100)
    orthotropic = model()
    fit = plain_fit(orthotropic.base, test, known=FLUID)
    for name, (_, truth) in SUPPORTS.items():
        assert fit.params[f"Ks_{name}"].value == pytest.approx(truth["kx"], rel=0.01)
        assert fit.params[f"Ds_{name}"].value == pytest.approx(truth["cx"], rel=0.05)
    with refuses(ValueError):
        plain_fit(orthotropic, test, known=FLUID)


def test_supports_that_are_the_same_in_x_and_y():
    M, G, K = matrices()
    planes = {"left": 1, "seal": 7, "right": 13}
    options = {"planes": planes, "fluid": "seal", "supports": ("left", "right")}
    known = rf.models.KnownStructure(M, None, G, K, **options)
    assert known.parameter_names[:4] == ("Ks_left", "Ks_right", "Ds_left", "Ds_right")
    w = np.array([100.0, -300.0])
    theta = known.vector({"Ks_left": 7e5, "Ks_right": 8e5, "Ds_left": 100.0, "Ds_right": 90.0, **FLUID})
    stiffened, C = K.copy(), np.zeros_like(K)
    for node, stiffness, damping in ((1, 7e5, 100.0), (13, 8e5, 90.0)):
        stiffened[2 * node, 2 * node] += stiffness
        C[2 * node, 2 * node] += damping
    whole = rf.models.KnownStructure(M, C, G, stiffened, planes=planes, fluid="seal")
    # Between a shaft on the ground and one that is free stands a condensed inverse with 1e-9 of round-off.
    np.testing.assert_allclose(known.receptance(theta, w, 200.0), whole.receptance(theta[4:], w, 200.0), rtol=1e-7)
    with refuses(ValueError):
        rf.models.KnownStructure(M, None, G, K, planes=planes, supports="left", damping="left")
