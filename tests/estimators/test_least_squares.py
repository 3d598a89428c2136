"""The least-squares engine: bounds, undefined regions, exceptions, fallbacks, scaling, partial results."""

import threading
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.typing import NDArray
from sentences import hear, refuses
from symbolic_residuals import SymbolicResiduals

from rotorfit.estimators.minimisation.least_squares import Options, Solution, Status, minimise

Array = NDArray[np.float64]


def symbolic(n: int, model: Callable[[Any], list[Any]]) -> SymbolicResiduals:
    x = ca.SX.sym("x", n)
    return SymbolicResiduals(ca.vertcat(*model(x)), x)


def rosenbrock() -> SymbolicResiduals:
    return symbolic(2, lambda x: [10 * (x[1] - x[0] ** 2), 1 - x[0]])


def decay(size: float = 1.0, rate: float = 1.0) -> SymbolicResiduals:
    """Amplitude and rate from noisy samples of an exponential, in units set by the two factors."""
    t = np.linspace(0, 3, 30)
    y = 2 * np.exp(-0.7 * t) + 0.05 * np.sin(40 * t)
    return symbolic(2, lambda x: [x[0] / size * ca.exp(-x[1] / rate * t[i]) - y[i] for i in range(30)])


class Wrapped:
    """An objective that hands over to another, after a hook."""

    def __init__(self, inner: SymbolicResiduals, hook: Callable[[Array], bool]) -> None:
        self.inner, self.hook = inner, hook
        self.calls = 0
        self.exact_calls = 0

    def cost(self, x: Array) -> float:
        self.calls += 1
        return np.nan if self.hook(x) else self.inner.cost(x)

    def gauss_newton(self, x: Array) -> tuple[float, Array, Array]:
        self.calls += 1
        if self.hook(x):
            return np.nan, np.full_like(x, np.nan), np.full((x.size, x.size), np.nan)
        return self.inner.gauss_newton(x)

    def hessian(self, x: Array) -> Array:
        self.exact_calls += 1
        return self.inner.hessian(x)


def recorder(seen: list[Array], undefined: Callable[[Array], bool] = lambda x: False) -> Callable[[Array], bool]:
    """A hook that notes every point."""

    def hook(x: Array) -> bool:
        seen.append(x.copy())
        return undefined(x)

    return hook


def test_zero_residual_problem_to_ten_digits() -> None:
    solution = minimise(rosenbrock(), [-1.2, 1.0])
    assert solution.success
    assert solution.message.startswith("converged")
    np.testing.assert_allclose(solution.x, 1.0, rtol=1e-10)
    assert solution.hessian == "gauss-newton"


def test_each_point_is_evaluated_once() -> None:
    seen: list[Array] = []
    objective = Wrapped(decay(), recorder(seen))
    solution = minimise(objective, [2.2, 0.9])  # near enough for every full step to be accepted
    assert len(seen) == len({x.tobytes() for x in seen})
    assert solution.n_evaluations == objective.calls
    assert objective.exact_calls == 0


def test_large_residuals_need_the_exact_hessian() -> None:
    # At the minimum the residual curvature exceeds JᵀJ, so Gauss-Newton steps overshoot for ever.
    t = np.array([1.0, 2.0, 3.0])
    y = np.array([2.0, 4.0, -8.0])
    hard = symbolic(1, lambda x: [ca.exp(t[i] * x[0]) - y[i] for i in range(3)])
    limited = minimise(hard, [1.0], options=Options(hessian="gauss-newton", max_iterations=12))
    assert limited.n_iterations <= 12
    objective = Wrapped(hard, lambda x: False)
    solution = minimise(objective, [1.0])
    assert solution.success
    assert objective.exact_calls > 0
    _, gradient, matrix = hard.gauss_newton(solution.x)
    assert abs(gradient[0]) < 1e-8 * np.sqrt(2 * solution.cost * matrix[0, 0])
    assert hard.hessian(solution.x)[0, 0] > 0


def test_exact_hessian_alone() -> None:
    exact = minimise(decay(), [1.0, 1.0], options=Options(hessian="exact"))
    assert exact.success
    assert exact.hessian == "exact"
    np.testing.assert_allclose(exact.x, minimise(decay(), [1.0, 1.0]).x, rtol=1e-9)


def test_active_bound_is_reached_exactly_and_the_others_adapt() -> None:
    free = minimise(decay(), [1.0, 1.0])
    bound = float(free.x[1]) * 1.1
    solution = minimise(decay(), [1.0, 1.0], lower=[0.0, bound], upper=np.inf)
    assert solution.success
    assert solution.x[1] == bound
    pinned = minimise(decay(), [1.0, bound], lower=[-np.inf, bound], upper=[np.inf, bound])
    assert solution.x[0] == pytest.approx(pinned.x[0], rel=1e-9)
    assert solution.cost > free.cost


def test_inactive_bounds_change_nothing() -> None:
    free = minimise(decay(), [1.0, 1.0])
    solution = minimise(decay(), [1.0, 1.0], lower=0.01, upper=100.0)
    np.testing.assert_allclose(solution.x, free.x, rtol=1e-9)


def test_start_on_a_bound() -> None:
    free = minimise(decay(), [1.0, 1.0])
    solution = minimise(decay(), [0.0, 0.0], lower=0.0)
    np.testing.assert_allclose(solution.x, free.x, rtol=1e-9)


def test_bounds_are_never_crossed() -> None:
    seen: list[Array] = []
    objective = Wrapped(rosenbrock(), recorder(seen))
    minimise(objective, [-1.0, 1.0], lower=[-1.5, 0.1], upper=[0.3, 3.0])
    assert (np.min(seen, axis=0) >= [-1.5, 0.1]).all()
    assert (np.max(seen, axis=0) <= [0.3, 3.0]).all()


@pytest.mark.parametrize("fixed", [0, 1])
def test_equal_bounds_fix_a_variable(fixed: int) -> None:
    lower, upper = np.full(2, -np.inf), np.full(2, np.inf)
    lower[fixed] = upper[fixed] = 0.5
    solution = minimise(decay(), [0.5, 0.5], lower=lower, upper=upper)
    assert solution.success
    assert solution.x[fixed] == 0.5
    assert solution.x[1 - fixed] != 0.5


def test_all_variables_fixed() -> None:
    solution = minimise(decay(), [1.0, 1.0], lower=1.0, upper=1.0)
    assert solution.success
    assert solution.x.tolist() == [1.0, 1.0]


def test_undefined_region_makes_the_line_search_backtrack() -> None:
    # From x = 4 the first Newton step lands at x < 0, where the root is undefined.
    root = symbolic(1, lambda x: [ca.sqrt(x[0]) - 0.1])
    seen: list[Array] = []
    objective = Wrapped(root, recorder(seen, lambda x: bool(x[0] < 0)))
    solution = minimise(objective, [4.0])
    assert min(seen)[0] < 0
    assert solution.success
    assert solution.x[0] == pytest.approx(0.01, rel=1e-9)


def test_undefined_start_is_reported() -> None:
    solution = minimise(Wrapped(decay(), lambda x: True), [1.0, 1.0])
    assert solution.status is Status.INFEASIBLE_START
    assert not solution.success
    assert solution.x.tolist() == [1.0, 1.0]


class BrokenModelError(Exception):
    pass


@pytest.mark.parametrize("after", [0, 1, 3])
def test_exception_of_the_objective_surfaces(after: int, capfd: pytest.CaptureFixture[str]) -> None:
    left = [after]

    def hook(x: Array) -> bool:
        left[0] -= 1
        if left[0] < 0:
            raise BrokenModelError("bearing 3 has no stiffness")
        return False

    with refuses(BrokenModelError):
        minimise(Wrapped(rosenbrock(), hook), [-1.2, 1.0])
    assert minimise(rosenbrock(), [-1.2, 1.0]).success  # the solver is usable afterwards
    assert capfd.readouterr() == ("", "")


def test_exception_of_the_exact_hessian_surfaces() -> None:
    class Broken(Wrapped):
        def hessian(self, x: Array) -> Array:
            raise BrokenModelError("no second derivatives")

    with refuses(BrokenModelError):
        minimise(Broken(decay(), lambda x: False), [1.0, 1.0], options=Options(hessian="exact"))


@pytest.mark.parametrize(("size", "rate"), [(1e6, 1e-6), (1e-9, 1e3), (1.0, 1e12)])
def test_units_of_the_parameters_do_not_matter(size: float, rate: float) -> None:
    plain = minimise(decay(), [1.0, 1.0])
    solution = minimise(decay(size, rate), [size, rate])
    np.testing.assert_allclose(solution.x / [size, rate], plain.x, rtol=1e-9)


@pytest.mark.parametrize("factor", [1e-9, 1e9])
def test_units_of_the_data_do_not_matter(factor: float) -> None:
    def scaled(k: float) -> Solution:
        return minimise(symbolic(2, lambda x: [k * 10 * (x[1] - x[0] ** 2), k * (2 - x[0]), k * x[0]]), [-1.2, 1.0])

    np.testing.assert_allclose(scaled(factor).x, scaled(1.0).x, rtol=1e-9)
    assert scaled(factor).success


def test_zero_start_gets_a_scale_from_the_residuals() -> None:
    solution = minimise(decay(1e6, 1e-6), [0.0, 1e-6])
    np.testing.assert_allclose(solution.x / [1e6, 1e-6], minimise(decay(), [1.0, 1.0]).x, rtol=1e-9)


def test_iteration_limit_returns_the_partial_estimate() -> None:
    start = np.array([-1.2, 1.0])
    solution = minimise(rosenbrock(), start, options=Options(max_iterations=2))
    assert solution.status is Status.ITERATION_LIMIT
    assert not solution.success
    hear(solution.message)
    assert solution.n_iterations == 2
    assert solution.cost < rosenbrock().cost(start)
    assert solution.cost == rosenbrock().cost(solution.x)


def test_redundant_parameters_are_reported_as_not_unique() -> None:
    solution = minimise(symbolic(2, lambda x: [x[0] + x[1] - 1, x[0] + x[1] - 2]), [3.0, 4.0])
    assert solution.status is Status.SINGULAR
    assert solution.cost == pytest.approx(0.25)


def test_nothing_is_changed_along_what_the_data_do_not_see() -> None:
    """An amplitude as a sum of two: round-off made some of the matrices definite, and steps along it of any length."""
    t = np.linspace(0, 3, 30)
    y = 2 * np.exp(-0.7 * t) + 0.05 * np.sin(40 * t)
    split = symbolic(3, lambda x: [(x[0] + x[1]) * ca.exp(-x[2] * t[i]) - y[i] for i in range(30)])
    whole = minimise(decay(), [2.0, 0.7], options=Options(tolerance=1e-12))
    rng = np.random.default_rng(1)
    for _ in range(40):
        start = np.array([1.4, 0.6, 0.7]) * rng.uniform(0.99, 1.01, 3)  # near enough for every step to be accepted
        solution = minimise(split, start)
        assert solution.status is Status.SINGULAR
        assert solution.cost == pytest.approx(whole.cost, rel=1e-12)
        # the derivatives by both are the same, hence a step that lies in what the data see changes both alike
        assert solution.x[0] - solution.x[1] == pytest.approx(start[0] - start[1], abs=1e-9)
        assert solution.x[[0, 2]] + [solution.x[1], 0.0] == pytest.approx(whole.x, rel=1e-6)
        assert solution.hessian == "gauss-newton"  # and no descent begins anew


def test_restart_at_the_solution_is_immediate() -> None:
    first = minimise(decay(), [1.0, 1.0])
    again = minimise(decay(), first.x)
    assert again.n_iterations <= 1
    assert again.cost == pytest.approx(first.cost, rel=1e-14)


def test_perfect_start() -> None:
    solution = minimise(rosenbrock(), [1.0, 1.0])
    assert solution.success
    assert solution.cost == 0.0


def test_nested_and_concurrent_fits() -> None:
    expected = minimise(decay(), [1.0, 1.0]).x
    nested = Wrapped(decay(), lambda x: not minimise(decay(), [1.0, 1.0]).success)
    np.testing.assert_array_equal(minimise(nested, [1.0, 1.0]).x, expected)
    results: list[Array] = []

    def work() -> None:
        results.extend(minimise(decay(), [1.0, 1.0]).x for _ in range(20))

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 80
    assert all(np.array_equal(x, expected) for x in results)


@pytest.mark.parametrize(
    "arguments",
    [
        {"start": [1.0, 1.0], "lower": [2.0, 0.0]},
        {"start": [1.0, 1.0], "upper": [1.0, 0.0]},
    ],
)
def test_wrong_arguments(arguments: dict[str, Any]) -> None:
    with refuses(ValueError):
        minimise(decay(), **arguments)


@pytest.mark.parametrize(
    "wrong",
    [{"max_iterations": 0}, {"method": "bfgs"}],
)
def test_wrong_options(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Options(**wrong)


def test_negative_cost_is_refused() -> None:
    class Negative(Wrapped):
        def gauss_newton(self, x: Array) -> tuple[float, Array, Array]:
            return -1.0, x, np.eye(x.size)

    with refuses(ValueError):
        minimise(Negative(decay(), lambda x: False), [1.0, 1.0])


def test_symbolic_residuals_check_their_arguments() -> None:
    x, other = ca.SX.sym("x", 2), ca.SX.sym("k")
    with refuses(ValueError):
        SymbolicResiduals(x * other, x)
    with refuses(ValueError):
        SymbolicResiduals(x.T, x)


def test_symbolic_derivatives_agree_with_each_other() -> None:
    objective, x = decay(), np.array([1.3, 0.4])
    cost, gradient, matrix = objective.gauss_newton(x)
    jacobian, residuals = objective.jacobian(x), objective.residuals(x)
    assert cost == objective.cost(x) == pytest.approx(residuals @ residuals / 2)
    np.testing.assert_allclose(gradient, jacobian.T @ residuals)
    np.testing.assert_allclose(matrix, jacobian.T @ jacobian)
    step = 1e-6
    columns = [
        (objective.gauss_newton(x + step * e)[1] - objective.gauss_newton(x - step * e)[1]) / (2 * step)
        for e in np.eye(2)
    ]
    np.testing.assert_allclose(objective.hessian(x), np.array(columns), rtol=1e-7)
