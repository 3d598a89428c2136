"""Forces and readings counted from one zero, once the angle between their zeros is known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rotorfit.data.experiments import Experiment, PerturbationTest


def at_common_zero(experiments: Sequence[Experiment], datum: float) -> tuple[Experiment, ...]:
    """Experiments with their turning forces counted from the zero of the readings."""
    turn = np.exp(1j * datum)
    return tuple(
        test.with_forces(lambda force: force * turn) if isinstance(test, PerturbationTest) else test
        for test in experiments
    )
