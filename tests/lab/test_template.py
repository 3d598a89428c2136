"""A setup to fill in is made from the recording's own channels; raw signals given as vectors are told so."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from recorded import RATE, volts, write_hdf5
from sentences import refuses

import rotorfit as rf
from rotorfit.lab.recordings.rig.rig_toml import setup_of
from rotorfit.lab.recordings.rig.setup import ForceSetup
from rotorfit.lab.recordings.rig.template import template


def test_a_recording_that_says_all_gets_a_template_that_reads_at_once(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "run.h5", volts())
    setup = tmp_path / "rig.toml"
    setup.write_text(template(path))
    with_setup, without = rf.read_recording(path, setup), rf.read_recording(path)
    assert repr(with_setup.force) == repr(without.force)  # NaN stands for what is not given
    assert repr(with_setup.probes) == repr(without.probes)
    # and with every comment taken away it says the same itself
    keys = ("#", "sample", "speed", "[force", "plane", "mr_", "angle", "whirl", "sens", "pulses")
    filled = [
        line[2:] if line.startswith(tuple(f"# {key}" for key in keys)) else line for line in template(path).split("\n")
    ]
    setup.write_text("\n".join(filled))
    bare = write_hdf5(tmp_path / "bare.h5", volts(), {})
    assert repr(rf.read_recording(bare, setup).force) == repr(without.force)


def test_a_template_to_fill_in_is_refused_until_it_is(tmp_path: Path) -> None:
    path = write_hdf5(tmp_path / "run.h5", volts(), {})
    setup = tmp_path / "rig.toml"
    text = template(path)
    assert (
        text.count("FILL IN") == 11
    )  # rate, four of two probes, of two marks, the force and three of its keys, how to
    setup.write_text(text)
    with refuses(ValueError):
        rf.read_recording(path, setup)
    text = text.replace("# angle_deg = 0.0  ", "angle_deg = 0.0  ").replace("# sensitivity", "sensitivity")
    setup.write_text(text.replace("# sample_rate_hz = 6400", "sample_rate_hz = 3200"))
    assert rf.read_recording(path, setup).sample_rate == RATE


def test_the_setup_of_the_documents_is_one() -> None:
    page = (Path(__file__).parents[2] / "docs" / "volts.md").read_text(encoding="utf-8")
    setup = setup_of(tomllib.loads(page.partition("```toml\n")[2].partition("```")[0]), "rig.toml")
    assert setup.of_file("disk-bwd.h5").force == ForceSetup(
        plane="disk", mr=pytest.approx(2e-5), angle=np.radians(-120.0), whirl=-1
    )
    assert setup.of_file("other.h5").force == ForceSetup(
        plane="disk", mr=pytest.approx(2e-5), angle=np.radians(33.0), whirl=1
    )
