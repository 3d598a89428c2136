"""Limits of double precision, by which matrices and sums are judged everywhere."""

from __future__ import annotations

ROUND_OFF = 1e-13
"""Relative size of zero after rounding in sums and factorisations: some hundred times the machine's epsilon."""

RANK_TOLERANCE = 1e-11
"""Singular value or eigenvalue, over the largest, that is zero in scaled matrices, two digits above round-off."""

COLLINEAR = 1e-9
"""Share of a column that others leave of it, down to which it depends on them: numbers of files have ten digits."""
