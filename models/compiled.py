"""Turn a CasADi expression graph into one Python function of NumPy arrays.

The CasADi virtual machine evaluates one point a call. Fits and samplers want thousands of parameter vectors at once, so
the same graph is written out as a sequence of array operations: every input may be an array, all broadcast together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import casadi as ca
import numpy as np

from rotorfit.base.array_types import Float

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


def statements(function: ca.Function, read: Callable[[int], str], write: Callable[[int, str], str]) -> list[str]:
    """The scalar instructions of a CasADi SX function as Python statements, with inputs and outputs, by the running
    numbers of their nonzeros, spelled by the caller. They are arithmetic and NumPy ufuncs only, so that they run on
    arrays and compile under numba on scalars alike."""
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
    lines = statements(function, "v{}".format, "out[{}] = {}".format) or ["pass"]
    arguments = "".join(f"v{i}, " for i in range(sum(function.nnz_in(i) for i in range(function.n_in()))))
    source = f"def kernel({arguments}out):\n    " + "\n    ".join(lines) + "\n"
    exec(compile(source, f"<casadi {function.name()}>", "exec"), namespace)
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
