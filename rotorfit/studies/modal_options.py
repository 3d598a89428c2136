"""Options of a modal model that suit the data, where a study leaves them open."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from rotorfit.data.experiments import Experiment, PerturbationTest


def modal_options(planes: Sequence[str], experiments: Sequence[Experiment]) -> dict[str, Any]:
    """Options of a modal model that suit the data: the plane that moves most is the one to normalise at."""
    tests = [test for test in experiments if isinstance(test, PerturbationTest)]
    size = {plane: 0.0 for test in tests for plane in (*test.planes, *test.force_planes)}
    for test in tests:
        for plane in test.planes:
            size[plane] = max(size[plane], float(np.sqrt(np.mean(np.abs(test.response[test.plane == plane]) ** 2))))
    names = tuple(planes) or tuple(sorted(size, key=lambda plane: -size[plane]))
    forced = tuple(dict.fromkeys(p for t in tests for p in t.force_plane[t.force != 0].tolist() if p in names))
    measured = tuple(dict.fromkeys(p for t in tests for p in t.planes if p in names))
    paired = all({"x", "y"} == set(t.direction[t.plane == p].tolist()) for t in tests for p in t.planes)
    return {
        **({"planes": names} if names else {}),
        **({"force_planes": forced} if forced else {}),
        **({"probe_planes": measured} if measured else {}),
        "gains": "probe" if paired else "plane",
    }
