"""Errors of the data undone, by the names that findings give them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from rotorfit.data.experiments import Experiment, PerturbationTest
from rotorfit.diagnosis.orbits import orbits_of
from rotorfit.diagnosis.probe_pairs import uneven_planes
from rotorfit.diagnosis.trials.data_errors import (
    DataError,
    backward_angles,
    data_errors,
    filtered_probes,
    mirrored_orbits,
)
from rotorfit.models.parameters import unknown_name


def undone(experiments: Sequence[Experiment], names: Sequence[str]) -> tuple[Experiment, ...]:
    """The data with errors undone one after the other."""
    corrected = list(experiments)
    for name in names:
        known = {error.name: error for error in _possible(corrected)}
        if name not in known:
            raise ValueError(f"undo: {unknown_name('error of these data', name, known)}")
        error = known[name]
        corrected = [error.correct(test) if isinstance(test, PerturbationTest) else test for test in corrected]
    return tuple(corrected)


def _possible(experiments: Sequence[Experiment]) -> Iterator[DataError]:
    """Every error that the data may have and that the data as given can be corrected for."""
    tests = [test for test in experiments if isinstance(test, PerturbationTest)]
    orbits = [orbits_of(test, np.arange(len(test))) for test in tests if test.force.all() and not test.several.any()]
    uneven = {plane: probe for of_test in orbits for plane, probe in uneven_planes(of_test).items()}
    found = [*mirrored_orbits(orbits), *filtered_probes(uneven), *backward_angles(tests), *data_errors(tests)]
    yield from (error for error in found if error.can_be_undone)
