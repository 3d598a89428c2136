"""Observations of many tests of one plan at once: their layout is worked out once, their readings are arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rotorfit.data.alike import AlikeTests
from rotorfit.data.directional import directional, directional_noise
from rotorfit.data.kept import unchanged
from rotorfit.estimators.blocks.observations import Responses
from rotorfit.estimators.noise.sweep_noise import noise_of_many
from rotorfit.models import RotorModel
from rotorfit.models.array_types import ComplexArray, Float
from rotorfit.observing.circular import Places, keep_observed, observe


@dataclass(frozen=True, eq=False, kw_only=True)
class AlikeResponses:
    """Responses of runs of one plan."""

    group: AlikeTests  # the tests
    layout: Responses  # observations of the first one
    measured: ComplexArray  # readings and noise of all of them, shape ``(W, R)``
    sigma: Float  # readings and noise of all of them, shape ``(W, R)``
    told: NDArray[np.bool_]  # runs whose noise was told as the first one's

    def keep(self, number: int) -> None:
        """Keep the observations of one run for whoever observes it next."""
        test, layout = self.group.tests[number], self.layout
        name = test.run[0]
        block = replace(
            layout,
            measured=self.measured[number].copy(),
            sigma=self.sigma[number].copy(),
            speed=np.full(layout.speed.size, self.group.speed[number]),
            labels=tuple(f"{name}{label[len(layout.run[0]) :]}" for label in layout.labels),
            run=np.full(layout.run.size, name),
        )
        keep_observed(test, block, np.zeros(len(test), dtype=np.intp))


def observe_alike(model: RotorModel, group: AlikeTests) -> AlikeResponses:
    """Observations of tests of one plan, as :func:`~rotorfit.observing.circular.observe` makes them one by one."""
    first = group.tests[0]
    with unchanged([first]):
        layout = observe(model, first, np.zeros(len(first), dtype=np.intp))
        places = Places.of(model, first)
    measured, wrong = directional(group.response, places.rows, places.backward)
    sigma = noise_of_many(layout, measured, wrong) if not layout.told else directional_noise(group.sigma, places.rows)
    told = np.asarray(np.isfinite(sigma).all(axis=1))
    return AlikeResponses(group=group, layout=layout, measured=measured, sigma=sigma, told=told)
