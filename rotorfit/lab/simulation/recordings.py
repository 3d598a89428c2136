"""Recordings of tests of a virtual rig: HDF5 files and a setup, as a data acquisition would have left them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Unpack

import numpy as np

from rotorfit.base.atomic_file import file_name, whole_file
from rotorfit.base.chance import Seed, chance
from rotorfit.base.names import unknown_name
from rotorfit.lab.simulation import recorded_kinds as kinds
from rotorfit.lab.simulation.instruments import Instruments, Played, record
from rotorfit.lab.simulation.rig import RecordedRig
from rotorfit.lab.simulation.simulate import RecordingOptions, checked_options
from rotorfit.lab.simulation.turbulence import Turbulence
from rotorfit.models import RotorModel

RECORDED: Mapping[str, Callable[..., Iterator[Played]]] = {
    "perturbation": kinds.perturbation,
    "dwell": kinds.dwell,
    "synchronous": kinds.synchronous,
    "balance": kinds.balance,
    "measured-force": kinds.measured_force,
    "impulse": kinds.impulse,
    "hammer": kinds.hammer,
    "release": kinds.release,
    "static-load": kinds.static_load,
    "operating": kinds.operating,
}
"""Kinds of tests that are recorded."""


def simulate_recordings(
    model: RotorModel,
    params: Mapping[str, float],
    folder: str | Path,
    kind: str = "perturbation",
    *,
    instruments: Instruments | None = None,
    residual: float = 1e-5,
    turbulence: Turbulence | float | None = None,
    rng: Seed = None,
    seed: Seed = None,
    **options: Unpack[RecordingOptions],
) -> list[Path]:
    """Record tests of a virtual rig: raw volts of probes and Keyphasors in HDF5 files that say what they are.

    The rotor is integrated in time. One with a law of eccentricity may run up through its onset of instability: the
    start-up holds its whirl, as large as the law lets it become. Options of the kinds:

    - ``perturbation``: speed_rpm, sweep_rpm (first and last), duration, unbalance, planes, directions
    - ``dwell``: frequency_rpm, speed_rpm, duration (of each dwell), unbalance, planes, directions, mark (of the
      perturbator; without one each dwell is a file)
    - ``synchronous``: speed_rpm (first and last), duration, unbalance, planes, hole_zero_deg, hole_deg (places of the
      weight, 0 and 180 unless given), reference (a run without a weight as well)
    - ``balance``: the same at steady speeds, a run without a weight and one with it at 0 degrees unless given
    - ``measured-force``: speed_rpm, sweep_rpm, duration, force, planes, directions (forward, backward, x, y)
    - ``impulse``: speed_rpm, impulse (N s), plane, blows, apart (s)
    - ``hammer``: the same, with the force measured
    - ``release``: speed_rpm, load, load_deg, plane, duration; a load that is let go
    - ``static-load``: load, speed_rpm, load_deg, plane, duration
    - ``operating``: speed_rpm, duration; nothing but turbulence and the rotor's own unbalance shakes it

    A ``rig.toml`` beside the files says what they do not.

    Args:
        model: the rotor.
        params: its true parameters, SI units.
        folder: where the files go; it is made if it is not there.
        kind: a name above.
        instruments: what measures, by default :class:`rotorfit.lab.simulation.instruments.Instruments`.
        residual: unbalance of the rotor itself in each plane in start-ups, balance runs and operation, kg m.
        turbulence: random force of the flow on the planes in every run, as a :class:`rotorfit.Turbulence` or the level
            of a white one, N per root Hz; none by default. A nonlinear rotor whirls earlier with it.
        rng: of noise and chance, a generator or its seed, 0 by default.
        seed: the same.
        options: of the kind.

    Returns:
        the files.

    Raises:
        ValueError: unknown kind, a rotor that is unstable, turbulence that cannot be, or a load that is let go of one
            with a law of eccentricity.
        IntegrationError: the journal touches the wall.
        TypeError: an option that the kind does not have; names those that it has.
        KeyError: unknown or missing parameters.

    Example:
        >>> values = {"M": 1.2, "K": 8e3, "Ds": 8.0, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}
        >>> rotor = rf.models.OneMode()
        >>> files = rf.simulate_recordings(rotor, values, folder / "balance", "balance", speed_rpm=[600, 900])
        >>> [file.name for file in files]
        ['reference-600.h5', 'reference-900.h5', 'journal-0-600.h5', 'journal-0-900.h5']
    """
    if kind not in RECORDED:
        raise ValueError(unknown_name("kind of recorded test", kind, RECORDED))
    settings = checked_options(kind, options, RECORDED)
    place = Path(folder)
    place.mkdir(parents=True, exist_ok=True)
    drawn = np.random.default_rng(chance(rng, seed, 0))
    how = instruments or Instruments()
    flow = Turbulence(level=turbulence) if isinstance(turbulence, (int, float)) else turbulence
    rig = RecordedRig(
        model=model,
        theta=model.vector(params),
        rng=drawn,
        instruments=how,
        residual=residual,
        turbulence=flow,
    )
    files: dict[str, Path] = {}
    for played in RECORDED[kind](rig, **settings):
        name = file_name(played.name, files)
        files[name] = record(replace(played, name=name), how, place, drawn)
    with whole_file(place / "rig.toml") as draft:
        draft.write_text(_setup(kind, how, options), encoding="utf-8")
    return [*files.values()]


def _setup(kind: str, instruments: Instruments, options: RecordingOptions) -> str:
    """The ``rig.toml`` with what the files of a kind do not say themselves."""
    said = '# the files say the rest themselves\nrotation = "ccw"\n'
    if kind == "dwell" and not options.get("mark", True):
        said += "[perturbator]\nsteady = true\n"
    if kind in ("measured-force", "hammer"):
        axes = "xy" if kind == "measured-force" else "x"
        said += "[force]\n" + "".join(f'channel_{axis} = "force_{axis.upper()}"\n' for axis in axes)
        said += f"sensitivity_V_per_N = {instruments.force_sensitivity}\n"
    return said
