"""Probes: a factor of each one's reading (the paper's beta), and probes between the planes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import casadi as ca

from rotorfit.base.names import unknown_name
from rotorfit.models.complexes import Complex
from rotorfit.models.parameters import Parameter

Probes = tuple[tuple[str, tuple[tuple[str, float], ...]], ...]
"""Probes between the planes: each name with its shares of the motion of planes."""


def check_probes(probes: Mapping[str, Mapping[str, float]] | None, planes: Sequence[str], model: str) -> Probes:
    """Probes between planes as records that can be compared."""
    for name, shares in (probes or {}).items():
        if name in planes:
            raise ValueError(f"{model} has a plane {name!r} of its own; a probe between the planes has another name")
        if not all(math.isfinite(share) for share in shares.values()) or not any(shares.values()):
            raise ValueError(f"the probe {name!r} needs shares of the motion of planes, such as {{'{planes[0]}': 1.0}}")
        for plane in shares:
            if plane not in planes:
                raise ValueError(unknown_name(f"plane of the probe {name!r}", plane, planes))
    return tuple((name, tuple(shares.items())) for name, shares in (probes or {}).items())


def probe_parameters(planes: Sequence[str], probes: Probes) -> tuple[Parameter, ...]:
    """``beta1``, ``beta2``, ...: factors of the probes at the planes, then of those between, known to be one."""
    places = [*(f"at {plane}" for plane in planes), *(name for name, _ in probes)]
    return tuple(
        Parameter(f"beta{i}", "1", f"factor of the probe {where}", lower=0.0, default=1.0, nominal=1.0)
        for i, where in enumerate(places, 1)
    )


def with_probes(matrices: Sequence[Complex], planes: Sequence[str], probes: Probes) -> list[Complex]:
    """Coefficient matrices with a row for each probe between planes: its motion less the shares of theirs is zero."""
    n, extra = len(planes), len(probes)
    shares = ca.SX([[-dict(own).get(plane, 0.0) for plane in planes] for _, own in probes])
    right, nothing = ca.SX(n, extra), ca.SX(extra, n + extra)
    static = ca.horzcat(shares, ca.SX.eye(extra))
    return [
        Complex(
            ca.vertcat(ca.horzcat(matrix.re, right), nothing if power else static),
            ca.vertcat(ca.horzcat(matrix.im, right), nothing),
        )
        for power, matrix in enumerate(matrices)
    ]
