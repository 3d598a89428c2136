"""Vectors by windows: what turns with each reference, least squares over some turns, as tracking filters do.

Meant for figures and nonlinear tests. Swept quickly, such vectors are biased (the response of a second window turns
into that of a neighbouring frequency); what a fit takes comes from :mod:`rotorfit.estimators.signals.local_response`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorfit.models.array_types import ComplexArray, Float


def order_vectors(z: ComplexArray, angles: Sequence[Float], orders: int) -> ComplexArray:
    """Coefficients of ``exp(j k angle)`` of several references in one window, ``(references, 2 orders + 1)``, ``k``
    from ``-orders``, the mean with the first; NaN where angles drift apart by less than a turn, or from the mean."""
    rows, columns = [np.ones(z.shape[-1], dtype=complex)], [(0, orders)]
    separate = [_told_apart(i, angles) for i in range(len(angles))]
    for i, angle in enumerate(angles):
        turn = np.exp(1j * angle)
        for k in range(1, orders + 1):
            if separate[i]:
                rows += [turn**k, turn**-k]
                columns += [(i, orders + k), (i, orders - k)]
    basis = np.stack(rows)
    weighted = basis.conj() * np.hanning(z.shape[-1] + 2)[1:-1]
    solution = np.linalg.lstsq(weighted @ basis.T, weighted @ z.T, rcond=None)[0]
    found = np.zeros((len(angles), 2 * orders + 1, *z.shape[:-1]), dtype=complex)
    for i, good in enumerate(separate):
        found[i] = 0.0 if good else np.nan
    for (i, column), value in zip(columns, solution, strict=True):
        found[i, column] = value
    return found


def _told_apart(number: int, angles: Sequence[Float]) -> bool:
    """True if a reference makes a turn more or less than those before it in the window, and at least one itself."""
    own = angles[number][-1] - angles[number][0]
    others = [angle[-1] - angle[0] for i, angle in enumerate(angles) if i < number]
    return abs(own) > 2 * np.pi and all(abs(abs(own) - abs(other)) > 2 * np.pi for other in others)
