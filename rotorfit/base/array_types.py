"""Names of the array types that signatures use, and how far their numbers are round-off; docstrings give the shapes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Index = NDArray[np.intp]
"""Places in another array."""
Bool = NDArray[np.bool_]
Text = NDArray[np.str_]
Records = NDArray[np.object_]
"""One Python object a row."""

ROUND_OFF = 1e-13
"""Relative size of zero after rounding in sums and factorisations: some hundred times the machine's epsilon."""

RANK_TOLERANCE = 1e-11
"""Singular value or eigenvalue, over the largest, that is zero in scaled matrices, two digits above round-off."""

COLLINEAR = 1e-9
"""Share of a column that others leave of it, down to which it depends on them: numbers of files have ten digits."""
