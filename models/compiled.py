"""Turn a CasADi expression graph into one Python function of NumPy arrays.

The CasADi virtual machine evaluates one point a call. Fits and samplers want thousands of parameter vectors at once, so
the same graph is written out as a sequence of array operations: every input may be an array, all broadcast together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from rotorfit.models.array_types import Float

_BINARY = {
    ca.OP_ADD: "{} + {}",
    ca.OP_SUB: "{} - {}",
    ca.OP_MUL: "{} * {}",
    ca.OP_DIV: "{} / {}",
    ca.OP_POW: "{} ** {}",
    ca.OP_CONSTPOW: "{} ** {}",
    ca.OP_ATAN2: "np.arctan2({}, {})",
    ca.OP_FMIN: "np.minimum({}, {})",
    ca.OP_FMAX: "np.maximum({}, {})",
    ca.OP_LT: "1.0 * ({} < {})",
    ca.OP_LE: "1.0 * ({} <= {})",
    ca.OP_EQ: "1.0 * ({} == {})",
    ca.OP_NE: "1.0 * ({} != {})",
    ca.OP_AND: "1.0 * (({} != 0) & ({} != 0))",
    ca.OP_OR: "1.0 * (({} != 0) | ({} != 0))",
    # CasADi's if_else: the second operand where the first holds, else exactly zero (never nan * 0).
    ca.OP_IF_ELSE_ZERO: "np.where({0} != 0, {1}, 0.0)",
}
_UNARY = {
    ca.OP_ASSIGN: "{}",
    ca.OP_NEG: "-{}",
    ca.OP_NOT: "1.0 * ({} == 0)",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "2.0 * {}",
    ca.OP_INV: "1.0 / {}",
    ca.OP_SQRT: "np.sqrt({})",
    ca.OP_EXP: "np.exp({})",
    ca.OP_LOG: "np.log({})",
    ca.OP_LOG1P: "np.log1p({})",
    ca.OP_EXPM1: "np.expm1({})",
    ca.OP_SIN: "np.sin({})",
    ca.OP_COS: "np.cos({})",
    ca.OP_TAN: "np.tan({})",
    ca.OP_ASIN: "np.arcsin({})",
    ca.OP_ACOS: "np.arccos({})",
    ca.OP_ATAN: "np.arctan({})",
    ca.OP_SINH: "np.sinh({})",
    ca.OP_COSH: "np.cosh({})",
    ca.OP_TANH: "np.tanh({})",
    ca.OP_FABS: "np.abs({})",
    ca.OP_SIGN: "np.sign({})",
}


def _python_source(function: ca.Function) -> str:
    """Write the scalar instructions of a CasADi SX function as Python source. The source defines ``kernel(v0, v1, ...,
    out)``: one argument for each scalar input (the nonzeros of all inputs in order) and ``out``, indexed by the running
    number of the output nonzero. It holds arithmetic and NumPy ufuncs only, so that it runs on arrays and compiles
    under numba on scalars alike."""
    n_inputs = sum(function.nnz_in(i) for i in range(function.n_in()))
    lines = statements(function, "v{}".format, "out[{}] = {}".format)
    arguments = ", ".join([f"v{i}" for i in range(n_inputs)] + ["out"])
    return f"def kernel({arguments}):\n    " + "\n    ".join(lines or ["pass"]) + "\n"


def statements(function: ca.Function, read: Callable[[int], str], write: Callable[[int, str], str]) -> list[str]:
    """Statements of :func:`_python_source`, with inputs and outputs spelled by the caller."""
    offsets_in = np.cumsum([0] + [function.nnz_in(i) for i in range(function.n_in())])
    offsets_out = np.cumsum([0] + [function.nnz_out(i) for i in range(function.n_out())])
    lines = []
    for k in range(function.n_instructions()):
        op = function.instruction_id(k)
        source, target = function.instruction_input(k), function.instruction_output(k)
        if op == ca.OP_INPUT:
            lines.append(f"w{target[0]} = {read(int(offsets_in[source[0]]) + source[1])}")
        elif op == ca.OP_OUTPUT:
            lines.append(write(int(offsets_out[target[0]]) + target[1], f"w{source[0]}"))
        elif op == ca.OP_CONST:
            lines.append(f"w{target[0]} = {function.instruction_constant(k)!r}")
        elif op in _BINARY:
            lines.append(f"w{target[0]} = " + _BINARY[op].format(f"w{source[0]}", f"w{source[1]}"))
        elif op in _UNARY:
            lines.append(f"w{target[0]} = " + _UNARY[op].format(f"w{source[0]}"))
        else:
            raise NotImplementedError(f"CasADi operation {op} in {function.name()} has no array translation")
    return lines


def array_function(function: ca.Function) -> Callable[[Sequence[Float]], Float]:
    """A CasADi SX function on arrays: inputs one by one that broadcast to ``S``, outputs ``(n_outputs, *S)``."""
    namespace: dict[str, object] = {"np": np, "inf": np.inf, "nan": np.nan}  # as constants are written
    exec(compile(_python_source(function), f"<casadi {function.name()}>", "exec"), namespace)
    kernel = namespace["kernel"]
    size = sum(function.nnz_out(i) for i in range(function.n_out()))

    def evaluate(inputs: Sequence[Float]) -> Float:
        shapes = {getattr(value, "shape", ()) for value in inputs}
        # Working out a common shape takes longer than evaluating scalars.
        shape = shapes.pop() if len(shapes) == 1 else np.broadcast_shapes(*shapes)
        out = np.empty((size, *shape))
        kernel(*inputs, out)  # type: ignore[operator]
        return out

    return evaluate
