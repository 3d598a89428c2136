"""The modal model: a sum of modes written out by hand, and an independent two-disk rotor seen as two modes."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from hammer_tests import EIGHT, MODES, hammer_test
from plain import plain_fit
from sentences import refuses

import rotorfit as rf
from rotorfit.identify.fitting.structure.modes import own_modes

RPM = np.pi / 30


def by_hand(
    model: rf.models.Modal, values: dict[str, float], w: np.ndarray, plane: str, axis: str, at: str
) -> np.ndarray:
    """Response at a probe to a unit force along the axis at a plane, straight from the sum over the modes."""
    total = np.zeros(w.shape, dtype=complex)
    for number in range(1, model.modes + 1):
        tag = str(number) if model.modes > 1 else ""
        own = f"_{axis}" if model.apart else ""
        end = "" if axis == "z" else f"_{axis}"
        mass, wn, zeta = values[f"M{tag}"], values[f"wn{tag}{own}"], values[f"zeta{tag}{own}"]
        first = model.planes[0]
        name = f"g{tag}_{plane}{end}"
        gain = values.get(name, 1.0) + 1j * values.get(f"{name}_im", 0.0)
        phi = 1.0 if at == first else values[f"phi{tag}_{at}"] + 1j * values.get(f"phi{tag}_{at}_im", 0.0)
        total += gain * phi / (mass * (wn**2 - w**2 + 2j * zeta * wn * w))
    return total


@pytest.mark.parametrize(("gains", "apart"), [("plane", False), ("probe", False), ("probe", True)])
@pytest.mark.parametrize("modes", [1, 2])
def test_receptance_is_the_sum_over_the_modes(gains: Literal["plane", "probe"], apart: bool, modes: int) -> None:
    rng = np.random.default_rng(1)
    model = rf.models.Modal(("a", "b", "c"), modes=modes, gains=gains, apart=apart)
    values = {q.name: float(rng.uniform(0.3, 1.5)) * q.scale for q in model.parameters}
    w = np.linspace(20.0, 300.0, 7)
    H = model.receptance(model.vector(values), w, 0.0)
    for axis in ("x", "y") if gains == "probe" else ("z",):
        for plane in model.planes:
            for at in model.planes:
                found = H[:, model.coordinate(plane, axis), model.coordinate(at, axis)]
                expected = by_hand(model, values, w, plane, axis, at)
                # one matrix inversion of numbers from 1 to 1e5: round-off of 1e-10 at the worst
                np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_free_vibration_is_that_of_the_modes() -> None:
    model = rf.models.Modal(("a", "b"), modes=2, gains="plane")
    values = {q.name: 1.0 for q in model.parameters} | {"wn1": 150.0, "zeta1": 0.03, "wn2": 420.0, "zeta2": 0.01}
    s = rf.models.eigenvalues(model, model.vector(values), 0.0)
    s = s[np.isfinite(s)]
    expected = [
        wn * (-zeta + sign * 1j * np.sqrt(1 - zeta**2)) for wn, zeta in ((150, 0.03), (420, 0.01)) for sign in (-1, 1)
    ]
    by_frequency = [values[np.argsort(values.imag)] for values in (s, np.array(expected))]
    np.testing.assert_allclose(*by_frequency, rtol=1e-10)


def test_a_symmetric_two_disk_rotor_is_two_modes() -> None:
    """With proportional damping the undamped modes of ``TwoDisk`` are the modes of ``Modal``, one at its first disk."""
    mass, k1, k2 = 0.8, 2e4, 6e4
    stiffness = np.array([[k1 + k2, -k2], [-k2, k2 + k1]])
    ratio = 2e-4
    damping = ratio * stiffness
    two = rf.models.TwoDisk()
    theta = two.vector({
        "M1": mass, "M2": mass, "K1": k1, "K2": k2, "K3": k1,
        "D11": damping[0, 0], "D12": -damping[0, 1], "D21": -damping[1, 0], "D22": damping[1, 1],
    })  # fmt: skip
    values = {}
    for number, (shape, k) in enumerate((((1, 1), k1), ((1, -1), k1 + 2 * k2)), start=1):
        wn = float(np.sqrt(k / mass))
        values |= {f"M{number}": 2 * mass, f"wn{number}": wn, f"zeta{number}": ratio * wn / 2}
        values |= {
            f"phi{number}_outboard": float(shape[1]),
            f"g{number}_outboard": float(shape[1]),
            f"g{number}_outboard_im": 0.0,
        }
    modal = rf.models.Modal(two.planes, modes=2, gains="plane")
    w = np.linspace(20, 700, 9)
    seen = modal.receptance(modal.vector(values), w, 0.0)[:, :2, :2]
    np.testing.assert_allclose(seen, two.receptance(theta, w, 0.0), rtol=1e-9)


def test_only_what_is_forced_and_measured_has_parameters() -> None:
    model = rf.models.Modal(("a", "b"), gains="plane", force_planes=("a",), probe_planes=("b",))
    assert model.parameter_names == ("M", "wn", "zeta")
    H = model.receptance(model.vector({"M": 2.0, "wn": 100.0, "zeta": 0.05}), 50.0, 0.0)
    assert H[1, 0] == pytest.approx(1 / (2.0 * (100**2 - 50**2 + 2j * 0.05 * 100 * 50)))
    assert H[0, 0] == 0


@pytest.mark.parametrize(
    "options",
    [
        {"planes": ()},
        {"planes": ("a", "a")},
        {"gains": "none"},
        {"gains": "plane", "apart": True},
        {"modes": 0},
        {"force_planes": ("disk3",)},
        {"probe_planes": ()},
    ],
)
def test_wrong_options_are_refused_in_words(options: dict[str, object]) -> None:
    with refuses(ValueError):
        rf.models.Modal(**options)  # type: ignore[arg-type]


# ---- from two modes to two disks (eq. 23) ------------------------------------------------------------------------


def test_published_modes_give_the_published_damping() -> None:
    """Modal masses, frequencies, dampings and shapes of the paper; D is rounded to 0.1, shapes to two digits."""
    from rotorfit.identify.fitting.structure.modes import disk_values

    model = rf.models.Modal(("inboard", "outboard"), modes=2, gains="plane")
    values = {
        "M1": 1.5, "wn1": np.sqrt(41000 / 1.5), "zeta1": 14.9 / (2 * np.sqrt(41000 * 1.5)), "phi1_outboard": 0.99,
        "M2": 1.43, "wn2": np.sqrt(279000 / 1.43), "zeta2": 40.4 / (2 * np.sqrt(279000 * 1.43)), "phi2_outboard": -0.94,
        "g1_outboard": 1.0, "g1_outboard_im": 0.0, "g2_outboard": 1.0, "g2_outboard_im": 0.0,
    }  # fmt: skip
    found = disk_values(model, model.vector(values))
    for name, published in {"D11": 14.2, "D22": 14.8, "D12": 7.0, "D21": 7.0}.items():
        assert found[name] == pytest.approx(published, abs=0.15)
    assert found["M1"] == pytest.approx(0.73, abs=0.01)
    assert found["M2"] == pytest.approx(0.79, abs=0.01)
    assert abs(found["M12"]) < 0.01
    assert found["K2"] == pytest.approx(63700, rel=0.02)


def test_two_modes_of_start_ups_give_the_disks() -> None:
    """Start-ups of a simulated two-disk rotor through both resonances, fitted as two modes and turned into disks."""
    test, truth = rf.datasets.two_disk(), rf.datasets.truth("two_disk")
    fit = plain_fit(rf.models.Modal(("inboard", "outboard"), modes=2, gains="plane"), test)
    assert fit.success
    found = rf.two_disk_from_modes(fit)
    direct = plain_fit(rf.models.TwoDisk(), test)
    for name in ("M1", "M2", "K1", "K2", "K3", "D11", "D12", "D22"):
        # real participations: damping that couples the modes a little is left out, a percent of the widths
        assert found[name].value == pytest.approx(direct.params[name].value, rel=0.03), name
        assert found[name].stderr < 0.05 * abs(found[name].value)
    assert abs(found["M12"].value) < 4 * found["M12"].stderr + 0.01
    assert truth


def test_modes_that_are_parameters_are_asked_for_as_such() -> None:
    """Nor are they a table beside the fit: writing it ended in an IndexError where one direction was measured."""
    fit = plain_fit(rf.models.Modal(EIGHT, modes=3, gains="plane", force_planes=("s0",)), hammer_test(400, 0.95, 1))
    with refuses(ValueError):
        fit.modes()
    assert own_modes(fit) is None


def test_other_models_have_no_modes_to_turn_into_disks() -> None:
    fit = plain_fit(rf.models.TwoDisk(), rf.datasets.two_disk())
    with refuses(ValueError):
        rf.two_disk_from_modes(fit)


@pytest.mark.parametrize(("gains", "apart"), [("plane", False), ("probe", False), ("probe", True)])
@pytest.mark.parametrize("residuals", [True, False])
def test_sums_of_terms_are_the_solution_of_the_equation(gains, apart, residuals) -> None:
    """Readings and their derivatives, without matrices, against the dynamic stiffness and differences."""
    from rotorfit.estimators.blocks.observations import Responses

    rng = np.random.default_rng(2)
    model = rf.models.Modal(
        ("a", "b", "c"), modes=2, gains=gains, apart=apart, force_planes=("c", "a"), residuals=residuals
    )
    theta = rng.uniform(0.3, 1.5, (2, len(model.parameters))) * [q.scale for q in model.parameters]
    lines, read = 7, [k for k, c in enumerate(model.coordinates) if c.plane in model.planes]
    w = np.linspace(20.0, 300.0, lines)
    force = np.zeros((lines, len(model.coordinates)), dtype=complex)
    force[:, read] = rng.normal(size=(lines, len(read))) + 1j
    force[:, [model.coordinate("b", axis) for axis in {model.coordinates[k].axis for k in read}]] = 0.0
    none = np.zeros(lines * len(read))
    block = Responses(
        model=model, measured=none + 0j, sigma=none + 1.0, label=none.astype(int), labels=("all",),
        run=np.full(none.size, "r"), speed=np.zeros(lines), frequency=w, force=force,
        group=np.arange(lines) % 2, line=np.repeat(np.arange(lines), len(read)), coordinate=np.tile(read, lines),
    )  # fmt: skip
    found, slopes = block.predict_jacobian(theta)
    np.testing.assert_allclose(block.predict(theta), found, rtol=1e-12)
    for line, group in enumerate(block.group):
        stiffness = model.dynamic_stiffness(theta[group], w[line : line + 1], 0.0)[0]
        expected = np.linalg.solve(stiffness, force[line])[read]
        np.testing.assert_allclose(found[block.line == line], expected, rtol=1e-9)
    for place in range(theta.shape[1]):
        step = 1e-6 * theta[0, place]
        change = [block.predict(theta + sign * step * (np.arange(theta.shape[1]) == place)) for sign in (1, -1)]
        by_hand = (change[0] - change[1]) / (2 * step)
        np.testing.assert_allclose(slopes[:, place], by_hand, rtol=1e-6, atol=1e-6 * np.abs(by_hand).max())


# ---- many sensors ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("lines", "coherence"), [(400, 0.95), (2000, 0.5)])
def test_eight_sensors_and_three_modes(lines, coherence) -> None:
    """Responses along one axis at rest, as noisy as measured ones are: a second or two for 2000 lines."""
    model = rf.models.Modal(EIGHT, modes=3, gains="plane", force_planes=("s0",))
    fit = plain_fit(model, hammer_test(lines, coherence, seed=3))
    assert fit.success
    assert fit.nfev < 15
    assert 0.95 < fit.redchi < 1.05
    for name, values in MODES.items():
        for number, value in enumerate(values, start=1):
            p = fit.params[f"{name}{number}"]
            assert abs(p.value - value) < 4 * p.stderr, p.name


def test_modes_normalised_where_they_move_against_the_force() -> None:
    """Mass between the forced plane and that of the first probe is negative in modes in which these are opposed."""
    test = hammer_test(400, 0.95, seed=3)
    model = rf.models.Modal(("s5", *(s for s in EIGHT if s != "s5")), modes=3, gains="plane", force_planes=("s0",))
    fit = plain_fit(model, test)
    assert fit.success
    assert 0.9 < fit.redchi < 1.1
    shape = np.sin(np.arange(1, 4) * np.pi * (0.1 + 0.8 * 5 / 7)) / np.sin(np.arange(1, 4) * np.pi * 0.1)
    assert (shape < 0).any()
    for number, mass in enumerate(MODES["M"] / shape, start=1):
        p = fit.params[f"M{number}"]
        assert abs(p.value - mass) < 4 * p.stderr


def test_fewer_modes_than_the_responses_have() -> None:
    """One mode of three: the one that explains the responses best, and redchi says that it does not suffice."""
    model = rf.models.Modal(EIGHT, modes=1, gains="plane", force_planes=("s0",))
    fit = plain_fit(model, hammer_test(400, 0.8, seed=4))
    assert fit.success
    assert fit.redchi > 10
    assert np.abs(MODES["wn"] / fit.params["wn"].value - 1).min() < 0.01


def test_poles_by_vector_fitting() -> None:
    """Those of exact responses; and noise as large as the responses leaves them in sight."""
    from rotorfit.estimators.starting.modal_start import Response, common_poles

    rng = np.random.default_rng(0)
    w = np.linspace(60.0, 1250.0, 1500)
    factors = rng.normal(size=(8, 3)) + 1j * rng.normal(size=(8, 3))
    s = 1j * w[:, None]
    exact = factors @ (1 / (s**2 + 2 * MODES["zeta"] * MODES["wn"] * s + MODES["wn"] ** 2)).T
    poles = MODES["wn"] * (-MODES["zeta"] + 1j * np.sqrt(1 - MODES["zeta"] ** 2))
    found = common_poles([Response(w, one, np.ones(w.size)) for one in exact], 3)
    np.testing.assert_allclose(found, poles, rtol=1e-6)  # where it stops
    noise = np.abs(exact) * (rng.normal(size=exact.shape) + 1j * rng.normal(size=exact.shape)) / np.sqrt(2)
    found = common_poles([Response(w, one + n, 1 / np.abs(one)) for one, n in zip(exact, noise, strict=True)], 7)
    for pole in poles:
        assert np.abs(found - pole).min() < 0.01 * abs(pole)


def eight_sensors(noise: float, seed: int = 3) -> rf.PerturbationTest:
    """Three modes of a beam tapped at its first sensor, 400 lines."""
    rng, places = np.random.default_rng(seed), np.linspace(0.1, 0.9, 8)
    w = 2 * np.pi * np.linspace(10.0, 200.0, 400)
    response = np.zeros((8, w.size), dtype=complex)
    for k, (hertz, zeta, mass) in enumerate(((42.0, 0.02, 3.0), (95.0, 0.012, 2.0), (160.0, 0.02, 1.5)), 1):
        wn, shape = 2 * np.pi * hertz, np.sin(k * np.pi * places) / np.sin(k * np.pi * places[0])
        response += shape[:, None] / (mass * (wn**2 - w**2 + 2j * zeta * wn * w))
    sigma = noise * np.sqrt(np.mean(np.abs(response) ** 2, axis=1, keepdims=True)) * np.ones(w.size)
    response = response + sigma * (rng.normal(size=response.shape) + 1j * rng.normal(size=response.shape))
    return rf.perturbation_test(
        run="tap", speed=0.0, force_plane="s0", force=1.0, force_direction="x", direction="x",
        plane=np.repeat([f"s{i}" for i in range(8)], w.size), frequency=np.tile(w, 8), response=response.ravel(),
        sigma=sigma.ravel(),
    )  # fmt: skip


def beam(modes: int) -> rf.models.Modal:
    return rf.models.Modal(tuple(f"s{i}" for i in range(8)), modes=modes, gains="plane", force_planes=("s0",))


@pytest.mark.parametrize("noise", [0.02, 0.3])
def test_more_modes_than_the_responses_hold_are_refused_at_once(noise: float) -> None:
    from rotorfit.estimators.starting.modal_start import modal_start
    from rotorfit.lab.observing.circular import observe

    blocks = [observe(beam(3), test, np.zeros(len(test), dtype=np.intp)) for test in [eight_sensors(noise)]]
    values, _ = modal_start(beam(3), blocks)
    assert values["wn3"] / (2 * np.pi) == pytest.approx(160.0, rel=0.01)
    with refuses(ValueError):
        modal_start(beam(5), blocks)


def test_stabilisation_and_shapes_are_drawn() -> None:
    """Poles of the three modes are stable from some order on, and stay where the modes are."""
    from rotorfit.estimators.starting.modal_start import stabilisation

    fit = plain_fit(beam(3), eight_sensors(0.02))
    orders = stabilisation(beam(3), list(fit.problem.blocks), 7)
    for found in orders[4:]:
        stable = found.frequency[found.stable] / (2 * np.pi)
        assert all(np.abs(stable - hertz).min() < 0.01 * hertz for hertz in (42.0, 95.0, 160.0))
    figure = fit.plot.stabilisation(unit="hz")
    assert figure.axes[0].get_xlabel() == "frequency, Hz"
    assert len({axis.get_position().x0 for axis in fit.plot.bode().axes}) == 2  # columns: a page has no room for one
    shapes = fit.plot.mode_shapes(unit="hz")
    assert [axis.get_ylabel() for axis in shapes.axes] == ["mode 1, 42 Hz", "mode 2, 95 Hz", "mode 3, 160 Hz"]
    rig = plain_fit(rf.models.WhirlWhip(), rf.read(rf.datasets.path("rig_open.csv")), known={"K3": 6000.0})
    with refuses(ValueError):
        rig.plot.mode_shapes()


# ---- gains by linear least squares within the search -------------------------------------------------------------


def modal_problem(**settings: object):
    from rotorfit.identify.fitting.problem_setup import build_problem
    from rotorfit.identify.fitting.settings import FitSettings

    model = rf.models.Modal(EIGHT, modes=3, gains="plane", force_planes=("s0",), residuals=True)
    problem = build_problem(model, hammer_test(60, 0.9, seed=3), FitSettings(**settings))
    values = {q.name: q.scale for q in model} | {f"{n}{i}": v for n, w in MODES.items() for i, v in enumerate(w, 1)}
    x = np.array([values[name] for name in problem.space.base])
    return problem, x * np.random.default_rng(0).uniform(0.98, 1.02, x.size)


@pytest.mark.parametrize(
    "settings",
    [{}, {"known": {"g1_s3": 0.5}}, {"bounds": {"g2_s5": (-3.0, 3.0), "wn1": (200.0, 300.0)}}, {"per": {"wn1": "run"}}],
    ids=str,
)
def test_variable_projection_is_the_search_for_all_unknowns(settings) -> None:
    """Its optimum over the linear entries by a solver of all, its slope by differences, its matrix by elimination."""
    from scipy.optimize import lsq_linear

    from rotorfit.estimators.minimisation.projection import Projection

    problem, x = modal_problem(**settings)
    projection = Projection.of(problem)
    assert projection is not None
    y, linear = x[projection.kept], np.concatenate(list(projection.linear.values()))
    assert projection.kept.size == 9 + ("g2_s5" in str(settings))
    r, J = problem.jacobian(np.where(np.isin(np.arange(x.size), linear), 0.0, x))
    best = lsq_linear(np.concatenate([J.real, J.imag])[:, linear], -np.concatenate([r.real, r.imag])).x
    found = projection.vector(y)
    np.testing.assert_allclose(found[linear], best, rtol=1e-7, atol=1e-9 * np.abs(best).max())
    cost, gradient, matrix = projection.gauss_newton(y)
    assert cost == pytest.approx(problem.cost(found), rel=1e-12)
    for i, step in enumerate(1e-6 * np.abs(y)):
        ends = [projection.cost(y + sign * step * (np.arange(y.size) == i)) for sign in (1, -1)]
        assert gradient[i] == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-4)
    whole = problem.gauss_newton(found)[2]
    kept, own = np.ix_(projection.kept, projection.kept), np.ix_(linear, linear)
    cross = whole[np.ix_(projection.kept, linear)]
    eliminated = whole[kept] - cross @ np.linalg.solve(whole[own], cross.T)
    np.testing.assert_allclose(matrix, eliminated, rtol=1e-6, atol=1e-10 * np.abs(whole[kept]).max())


def test_what_is_not_linear_is_searched_for() -> None:
    """A robust loss, priors and bounds: no entry, or those others, are left to linear least squares."""
    from scipy import stats

    from rotorfit.estimators.minimisation.projection import Projection

    assert Projection.of(modal_problem(loss="huber")[0]) is None
    problem, _ = modal_problem(priors={"g1_s3": stats.norm(0.5, 0.1)}, bounds={"g2_s3": (0.0, 5.0)})
    projection = Projection.of(problem)
    assert projection is not None
    assert {problem.space.names[i] for i in projection.kept} >= {"g1_s3", "g2_s3", "wn1", "zeta3", "M2"}
    assert projection.kept.size == 11


def test_errors_by_channels_are_those_of_all_unknowns(monkeypatch) -> None:
    """Weights, leverages, memory and scatter of residuals: own numbers of each probe taken out, and kept."""
    from rotorfit.estimators.misfit.problem import Derivatives
    from rotorfit.estimators.noise.residuals import line_scatter, scatter, scatter_in_pieces
    from rotorfit.identify.fitting.noise import noise_fit

    fit = plain_fit(beam(3), eight_sensors(0.1))
    problem, x = fit.problem, fit.x

    def studied() -> noise_fit.NoiseFit:
        data = noise_fit.linearise(problem, x)
        assert data is not None
        sigma = data.sigma * np.random.default_rng(1).uniform(0.5, 1.5, data.sigma.size)
        return noise_fit.NoiseFit.of(data, sigma, np.zeros(len(data.kinds)))

    by_channel = studied()
    assert by_channel.data.own
    monkeypatch.setattr(noise_fit.Projection, "of", lambda problem: None)
    whole = studied()
    assert not whole.data.own
    np.testing.assert_allclose(by_channel.residuals.values, whole.residuals.values, atol=1e-9)
    np.testing.assert_allclose(by_channel.residuals.leverage, whole.residuals.leverage, atol=1e-9)
    one, other = (fit.memory(fit.sigma) for fit in (by_channel, whole))
    assert one.first == pytest.approx(other.first, abs=1e-9)

    derivatives, covar = Derivatives(problem, x), np.linalg.inv(problem.gauss_newton(x)[2])
    assert derivatives.in_channels
    pieces = [(np.arange(problem.n_data // 2), np.arange(x.size), derivatives.whole.T)]
    lines = noise_fit.lines_in(problem)
    found, expected = (line_scatter(derivatives.residuals, p, covar, lines) for p in (derivatives.pieces(), pieces))
    np.testing.assert_allclose(found.covar, expected.covar, rtol=1e-6, atol=1e-9 * np.abs(expected.covar).max())
    np.testing.assert_allclose(found.excess, expected.excess, atol=1e-6)
    sweeps = [sweep for sweeps in noise_fit.channels_of(problem) for sweep in sweeps]
    added = scatter(derivatives.whole, sweeps, (0.3, 0.1))
    by_piece = scatter_in_pieces(derivatives.pieces(), x.size, sweeps, (0.3, 0.1))
    np.testing.assert_allclose(by_piece, added, atol=1e-12 * np.abs(added).max())


def test_errors_in_parts_are_those_of_all_unknowns_together() -> None:
    """Covariance and verdict, with a gain that no reading sees left open by both."""
    from rotorfit.estimators.inference.covariance import parameter_scales
    from rotorfit.estimators.inference.projected_errors import projected_errors
    from rotorfit.estimators.minimisation.projection import Projection

    fit = rf.fit(beam(3), eight_sensors(0.1))
    scales = parameter_scales(fit.problem, fit.x)
    projection = Projection.of(fit.problem)
    assert projection is not None
    covar, verdict = projected_errors(projection, fit.x, scales)
    whole = np.linalg.inv(fit.problem.gauss_newton(fit.x)[2])
    sizes = np.sqrt(np.diag(whole))
    np.testing.assert_allclose(covar / np.outer(sizes, sizes), whole / np.outer(sizes, sizes), atol=1e-6)
    assert (verdict.rank, verdict.size) == (fit.identifiability.rank, fit.identifiability.size)
    assert verdict.unresolved == fit.identifiability.unresolved

    dark = fit.x.copy()
    dark[[fit.problem.space.names.index(name) for name in ("wn2", "M2")]] = 1e6, 1e12
    covar, verdict = projected_errors(projection, dark, scales)
    assert verdict.rank < verdict.size
    assert {"M2", "wn2", "zeta2", "g2_s3", "g2_s3_im"} <= set(verdict.unresolved)


# ---- populations -------------------------------------------------------------------------------------------------


def random_structure(
    seed: int, channels: int, modes: int, lines: int, *, outside: bool
) -> tuple[rf.PerturbationTest, dict[str, float]]:
    """Responses of a random structure with complex shapes, forced at its first channel, and its parameters;
    ``outside``: it has a mode far below and one far above the band too."""
    rng = np.random.default_rng(seed)
    w = 2 * np.pi * np.linspace(40.0, 200.0, lines)
    wn = 2 * np.pi * np.linspace(55.0, 185.0, modes) * (1 + rng.uniform(-0.1, 0.1, modes) / modes)
    zeta, mass = rng.uniform(0.005, 0.02, modes), rng.uniform(1.0, 3.0, modes)
    gains = rng.normal(size=(channels, modes)) + 0.2j * rng.normal(size=(channels, modes))
    gains[0] = 1.0
    response = gains / mass @ (1 / (wn[:, None] ** 2 - w**2 + 2j * zeta[:, None] * wn[:, None] * w))
    if outside:
        below, above = rng.normal(size=(2, channels, 1)) + 0.1j * rng.normal(size=(2, channels, 1))
        response = response + below / (2.0 * ((2 * np.pi) ** 2 - w**2)) + above / (2.0 * ((9000.0) ** 2 - w**2))
    sigma = 0.03 * np.sqrt(np.mean(np.abs(response) ** 2, axis=1, keepdims=True)) * np.ones(lines)
    response = response + sigma * (rng.normal(size=response.shape) + 1j * rng.normal(size=response.shape))
    names = [f"s{i}" for i in range(channels)]
    test = rf.perturbation_test(
        run="tap", speed=0.0, force_plane="s0", force=1.0, force_direction="x", direction="x",
        plane=np.repeat(names, lines), frequency=np.tile(w, channels), response=response.ravel(), sigma=sigma.ravel(),
    )  # fmt: skip
    truth = {
        f"{n}{i}": float(v) for n, all_ in (("wn", wn), ("zeta", zeta), ("M", mass)) for i, v in enumerate(all_, 1)
    }
    for (channel, mode), gain in np.ndenumerate(gains[1:]):
        truth |= {f"g{mode + 1}_s{channel + 1}": gain.real, f"g{mode + 1}_s{channel + 1}_im": gain.imag}
    return test, truth


@pytest.mark.parametrize("outside", [False, True])
def test_errors_hold_over_random_structures_of_many_channels(outside: bool) -> None:
    """Poles, masses and gains of 24 channels in units of their errors: rms one, by chance 0.11 off for 72 of each."""
    poles: list[float] = []
    gains: list[float] = []
    for seed in range(6):
        test, truth = random_structure(seed, channels=24, modes=4, lines=150, outside=outside)
        fit = rf.fit(rf.models.Modal(test.planes, modes=4, gains="plane", force_planes=("s0",)), test)
        assert fit.success
        assert fit.model.residuals is outside
        assert 0.95 < fit.redchi < 1.05
        for name, value in truth.items():
            (gains if name.startswith("g") else poles).append(
                (fit.params[name].value - value) / fit.params[name].stderr
            )
    assert 0.75 < np.sqrt(np.mean(np.square(poles))) < 1.25
    assert 0.95 < np.sqrt(np.mean(np.square(gains))) < 1.05
    assert np.mean(np.abs(gains) < 1.96) == pytest.approx(0.95, abs=0.015)


def test_more_than_nine_modes() -> None:
    test, truth = random_structure(1, channels=10, modes=14, lines=500, outside=False)
    fit = rf.fit(rf.models.Modal(test.planes, modes=14, gains="plane", force_planes=("s0",)), test)
    assert fit.success
    off = np.array([(fit.params[n].value - v) / fit.params[n].stderr for n, v in truth.items()])
    assert np.sqrt(np.mean(off**2)) == pytest.approx(1.0, abs=0.2)


def test_one_mode_among_the_damped_ones_of_its_bearings() -> None:
    """Eight sensors of a rotor in magnetic bearings, whose controllers damp the rigid modes below the band heavily: the
    bending mode, and what the others leave in the band as two terms a sensor."""
    rng = np.random.default_rng(0)
    w, x = 2 * np.pi * np.linspace(120.0, 210.0, 70), np.linspace(0.0, 1.0, 8)[:, None]
    response = np.zeros((8, w.size), dtype=complex)
    for k, (hertz, zeta) in enumerate(((28.0, 0.5), (45.0, 0.3), (162.5, 0.0156), (420.0, 0.004), (800.0, 0.004))):
        wn, shape = 2 * np.pi * hertz, np.cos(k * np.pi * x + 0.3 * k) / np.cos(0.3 * k)
        response += shape / (3.0 * (wn**2 - w**2 + 2j * zeta * wn * w)) * (0.3 if k == 2 else 1.0)
    sigma = 0.01 * np.abs(response)
    response = response + sigma * (rng.normal(size=response.shape) + 1j * rng.normal(size=response.shape))
    test = rf.perturbation_test(
        run="sweep", speed=0.0, force_plane="s0", force=1.0, force_direction="x", direction="x",
        plane=np.repeat(EIGHT, w.size), frequency=np.tile(w, 8), response=response.ravel(), sigma=sigma.ravel(),
    )  # fmt: skip
    fit = rf.fit(rf.models.Modal(EIGHT, gains="plane", force_planes=("s0",)), test)
    assert fit.success
    assert fit.model.residuals
    assert fit.params["wn"].value / (2 * np.pi) == pytest.approx(162.5, abs=0.1)
    assert fit.params["zeta"].value == pytest.approx(0.0156, abs=0.0005)
    plain = rf.fit(rf.models.Modal(EIGHT, gains="plane", force_planes=("s0",), residuals=False), test)
    assert plain.redchi > 100 * fit.redchi


def test_modes_and_not_planes_are_compared_with_what_weights_show() -> None:
    """Weights at two planes of a rotor kit near its first critical speed: one mode is seen."""
    test = rf.read(rf.datasets.path("rk4_sync.csv"))
    two = rf.models.Modal(planes=("disk2", "disk1"), gains="probe", modes=2)
    with refuses(ValueError):
        rf.fit(two, test, phase_offsets="common")
    assert rf.fit(two.variant(modes=1), test, phase_offsets="common").success
