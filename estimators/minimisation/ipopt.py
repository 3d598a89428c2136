"""CasADi's Ipopt as a reusable engine.

It asks a :class:`~rotorfit.estimators.minimisation.descent.Minimisation` for numbers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import casadi as ca
import numpy as np

from rotorfit.estimators.minimisation.descent import COST_FLOOR, Minimisation
from rotorfit.estimators.minimisation.objective import Options, Vector


class _Callback(ca.Callback):
    """A CasADi function computed by Python on raw buffers, which avoids CasADi's matrix conversions."""

    def __init__(
        self,
        name: str,
        inputs: list[tuple[str, Any]],
        outputs: list[tuple[str, Any]],
        compute: Callable[[Any, Any], None],
    ) -> None:
        ca.Callback.__init__(self)
        self._inputs, self._outputs, self._compute = inputs, outputs, compute
        self.construct(name, {"enable_fd": False})

    def get_n_in(self) -> int:
        return len(self._inputs)

    def get_n_out(self) -> int:
        return len(self._outputs)

    def get_name_in(self, i: int) -> str:
        return self._inputs[i][0]

    def get_name_out(self, i: int) -> str:
        return self._outputs[i][0]

    def get_sparsity_in(self, i: int) -> Any:
        return self._inputs[i][1]

    def get_sparsity_out(self, i: int) -> Any:
        return self._outputs[i][1]

    def has_eval_buffer(self) -> bool:
        return True

    def eval_buffer(self, arguments: Any, results: Any) -> int:
        self._compute(arguments, results)
        return 0


class Engine:
    """An Ipopt instance for n variables, for one :class:`Minimisation` at a time; kept, as building takes long."""

    def __init__(self, n: int, options: Options) -> None:
        self.run: Minimisation | None = None
        self._triangle = np.ravel_multi_index(np.tril_indices(n), (n, n))  # upper triangle, columns first
        dense = ca.Sparsity.dense
        x, p = ("x", dense(n, 1)), ("p", dense(0, 1))
        f, g = ("f", dense(1, 1)), ("g", dense(0, 1))
        lam = [("lam_f", dense(1, 1)), ("lam_g", dense(0, 1))]
        monitored = [dense(n, 1), dense(1, 1), dense(0, 1), dense(n, 1), dense(0, 1), dense(0, 1)]
        upper = ca.Sparsity.upper(n)
        # CasADi holds no references to Python callbacks: they must live as long as the solver.
        self._callbacks = {
            "nlp": _Callback("nlp", [x, p], [f, g], self._value),
            "grad_f": _Callback("grad_f", [x, p], [f, ("grad_f_x", dense(n, 1))], self._gradient),
            "jac_g": _Callback("jac_g", [x, p], [g, ("jac_g_x", dense(0, n))], self._nothing),
            "hess_lag": _Callback("hess_lag", [x, p, *lam], [("triu_hess_gamma_x_x", upper)], self._hessian),
            "iteration_callback": _Callback(
                "monitor", list(zip(ca.nlpsol_out(), monitored, strict=True)), [("stop", dense(1, 1))], self._monitor
            ),
        }
        settings = {k: v for k, v in self._callbacks.items() if k != "nlp"} | _SETTINGS | _CALLBACK_SETTINGS
        settings["ipopt.max_iter"] = options.max_iterations
        self._solver = ca.nlpsol("least_squares", "ipopt", self._callbacks["nlp"], settings)
        # Start and bounds go through memory shared with CasADi, results come back through the callbacks.
        self._start, self._low, self._high = np.zeros(n), np.zeros(n), np.zeros(n)
        self._buffer, self._solve = self._solver.buffer()  # the buffer is to be kept alive
        for name, array in (("x0", self._start), ("lbx", self._low), ("ubx", self._high)):
            self._buffer.set_arg(self._solver.index_in(name), array.data)  # type: ignore[call-arg]

    def descend(self, run: Minimisation, start: Vector) -> None:
        """Let Ipopt descend; the outcome is in ``run``."""
        self.run = run
        run.history.clear()
        run.error = None
        try:
            self._start[:], self._low[:], self._high[:] = start, run.low, run.high
            self._solve()
        finally:
            self.run = None
        if run.error is not None:
            raise run.error

    def _guard(self, compute: Callable[[Minimisation, Vector], Any], arguments: Any) -> Any:
        """Run Python inside Ipopt: exceptions are kept for :meth:`descend`, the point counts as undefined."""
        run = self.run
        if run is None or run.error is not None:
            return None
        try:
            return compute(run, np.frombuffer(arguments[0]))
        except BaseException as error:  # also a keyboard interrupt must travel around the C++ frames
            run.error = error
            return None

    def _value(self, arguments: Any, results: Any) -> None:
        value = self._guard(Minimisation.value, arguments)
        if results[0] is not None:
            np.frombuffer(results[0])[0] = math.nan if value is None else value

    def _gradient(self, arguments: Any, results: Any) -> None:
        gradient = self._guard(Minimisation.gradient, arguments)
        if results[0] is not None:
            self._value(arguments, results)
        if results[1] is not None:
            np.frombuffer(results[1])[:] = math.nan if gradient is None else gradient

    def _hessian(self, arguments: Any, results: Any) -> None:
        matrix = self._guard(Minimisation.hessian, arguments)
        if results[0] is not None:
            out = np.frombuffer(results[0])
            if matrix is None:
                out[:] = math.nan
            else:
                np.multiply(matrix.take(self._triangle), np.frombuffer(arguments[2])[0], out=out)

    def _monitor(self, arguments: Any, results: Any) -> None:
        stop = self._guard(lambda run, _: run.monitor(), arguments)
        if results[0] is not None:
            np.frombuffer(results[0])[0] = 1.0 if stop is None or stop else 0.0

    def _nothing(self, arguments: Any, results: Any) -> None:
        """There are no constraints, hence no derivatives of them."""


_SETTINGS: dict[str, Any] = {
    "print_time": False,
    "show_eval_warnings": False,
    "error_on_fail": False,
    "ipopt.sb": "yes",
    "ipopt.print_level": 0,
    "ipopt.nlp_scaling_method": "none",
    "ipopt.bound_relax_factor": 0.0,
    "ipopt.honor_original_bounds": "yes",
    "ipopt.fixed_variable_treatment": "make_parameter",
}
"""Settings of CasADi and Ipopt. Scaling is ours, so Ipopt's own is switched off."""

_CALLBACK_SETTINGS: dict[str, Any] = {
    "no_nlp_grad": True,
    "calc_lam_p": False,
    "calc_lam_x": False,
    "calc_f": False,
    "calc_g": False,
    "record_time": False,
    "ipopt.tol": 1e-16,  # the monitor stops the run
    "ipopt.acceptable_iter": 0,
    "ipopt.fast_step_computation": "yes",  # without equality constraints refinement gains nothing
    "ipopt.max_soc": 0,
    # A full step must earn a tenth of its promise: Gauss-Newton likes to leap to where the model is flat.
    "ipopt.eta_phi": 0.1,
    "ipopt.bound_push": 1e-8,
    "ipopt.bound_frac": 1e-8,
    "ipopt.bound_mult_init_method": "mu-based",
    "ipopt.mu_init": 1e-4,  # in units of the logarithm of the cost
}
"""Those of a descent by callbacks, in which stopping is ours too."""


def descend_on_graph(run: Minimisation, graph: ca.Function) -> None:
    """Let Ipopt descend on a cost that is a CasADi graph, with CasADi's derivatives; the outcome is in ``run``."""
    u = ca.MX.sym("u", run.start.size)
    cost = graph(u * run.scale) / run.reference
    settings = _SETTINGS | {"ipopt.max_iter": run.options.max_iterations}
    settings["ipopt.tol"] = 1e-8  # differences of the cost drown in round-off below; the last digits are refined
    solver = ca.nlpsol("fit", "ipopt", {"x": u, "f": ca.log(cost + COST_FLOOR)}, settings)
    found = solver(x0=run.start, lbx=run.low, ubx=run.high)["x"]
    run.n_iterations += int(solver.stats()["iter_count"])
    run.n_evaluations += int(solver.stats()["n_call_nlp_f"])
    run.kind = "exact"
    point = run.evaluate(np.clip(found.full()[:, 0], run.low, run.high))
    if point is not None:
        run.keep(run.assess(point))


_pool: dict[tuple[int, Options], list[Engine]] = {}


@contextmanager
def borrowed(n: int, options: Options) -> Iterator[Engine]:
    """An idle engine, for the next minimisation of the same size after that. ``list.pop`` and ``append`` are atomic:
    threads and nested fits never share one."""
    idle = _pool.setdefault((n, options), [])
    try:
        engine = idle.pop()
    except IndexError:
        engine = Engine(n, options)
    try:
        yield engine
    finally:
        idle.append(engine)
