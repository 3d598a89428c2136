"""Run-ups that are so fast that the free vibration rings on: their resonances come late."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from rotorfit.data.experiments import PerturbationTest
from rotorfit.data.findings import Finding
from rotorfit.estimators.signals.ramp import fit_ramp
from rotorfit.units import RPM_PER_RAD_S


def ramps(test: PerturbationTest) -> Iterator[Finding]:
    """A warning for each run whose amplitude beats beyond its resonance as a ramp of speed makes it."""
    if not test.synchronous:
        return
    for run in test.runs:
        mine = test.run == run
        channels = list(dict.fromkeys(zip(test.plane[mine].tolist(), test.direction[mine].tolist(), strict=True)))
        for plane, direction in channels:
            rows = np.flatnonzero(mine & (test.plane == plane) & (test.direction == direction))
            found = fit_ramp(test.speed[rows], test.response[rows])
            if found is None:
                continue
            late = rows[test.speed[rows] >= found.beats_from]
            rpm = RPM_PER_RAD_S
            text = (
                f"{plane} {direction} of run {run} beats beyond its resonance, from {found.beats_from * rpm:.0f} rpm "
                f"on: the speed changed by about {abs(found.rate) * rpm:.0f} rpm/s, too fast for the vibration to "
                f"settle. Taken as settled the resonance comes out at {found.steady_wn * rpm:.0f} rpm, with the ramp "
                f"fitted too at {found.wn * rpm:.0f} +- {found.wn_error * rpm:.1g} rpm. Leave out what beats, and run "
                "through the resonance more slowly."
            )
            yield Finding("warning", "ramp", text, tuple(int(row) for row in late))
            break  # one channel tells it for the run
