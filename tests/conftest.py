"""One thread of linear algebra for every test process, so that pytest-xdist's processes do not fight over the cores."""

import os

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")  # before NumPy is imported
os.environ.setdefault("MPLBACKEND", "agg")
