"""Names of the array types that signatures use; docstrings give the shapes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Index = NDArray[np.intp]
"""Places in another array."""
Bool = NDArray[np.bool_]
Text = NDArray[np.str_]
