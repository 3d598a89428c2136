"""Forms and words of the front, without a browser."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.io import wavfile

from rotorfit.lab.recordings.recording import read_recording
from rotorfit.lab.recordings.rig.rig_toml import setup_of

pytest.importorskip("panel", reason="of the extra app")
pytest.importorskip("tomli_w", reason="of the extra app")

pytestmark = pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")  # older Panels have no other names

MIL = 25.4e-6


@pytest.fixture
def form(tmp_path: Path) -> Any:
    """The form for two recordings of 16 bits, in which two probes and a mark are."""
    from rotorfit.apps.app.folder import Folder
    from rotorfit.apps.app.forms import SetupForm
    from rotorfit.apps.app.session import Session, chosen_entries

    t = np.arange(4000) / 2000
    mark = np.where((25 * t) % 1 < 0.1, 20000, 0)
    for name in ("light.wav", "heavy.wav"):
        counts = np.stack([8000 * np.cos(50 * np.pi * t), 8000 * np.sin(50 * np.pi * t), mark], axis=1)
        wavfile.write(tmp_path / name, 2000, counts.astype(np.int16))
    folder = Folder(tmp_path)
    session = Session(folder=folder).with_files(chosen_entries(folder, ["light.wav", "heavy.wav"]))
    page: Any = SimpleNamespace(session=session, opened_with=lambda _: None)
    return SetupForm(page, [folder.path(name) for name in session.recorded])


def test_a_setup_in_the_units_of_the_laboratory(form: Any, tmp_path: Path) -> None:
    """Full scale, V/mil, g mm, and a force of its own in one recording: read back in SI."""
    form._full.value = "10"
    for (name, row), angle in zip(list(form._rows.items())[:2], ("0", "90"), strict=True):
        row._role.value, row._plane.value, row._angle.value = "probe", "disk", angle
        row._probe.field.value, row._probe.unit.value = "0.2", "sensitivity_V_per_mil"
        assert name
    last = list(form._rows.values())[-1]
    last._role.value, last._angle.value = "mark of the shaft", "45"
    for one, unbalance in ((form._force, "30"), (form._forces["heavy.wav"], "60")):
        one._unbalance.field.value, one._unbalance.unit.value = unbalance, "mr_g_mm"
    form._force._plane.value, form._force._whirl.value = "disk", "forward"
    setup = setup_of(form.content(), "rig.toml")
    light, heavy = (read_recording(tmp_path / name, setup) for name in ("light.wav", "heavy.wav"))
    assert light.force is not None
    assert heavy.force is not None
    assert (light.force.mr, heavy.force.mr) == pytest.approx((30e-6, 60e-6))
    assert heavy.force.plane == "disk"
    full_volts, volts_per_m = 10.0, 0.2 / MIL
    motion = np.abs(light.motion("disk", 0, 4000)).max()
    assert motion == pytest.approx(8000 / 32767 * full_volts / volts_per_m, rel=2e-3)


def test_sentences_name_no_options() -> None:
    """All that refuses or warns, but for what the command line or Python alone can meet."""
    from rotorfit.apps.app.words import on_the_page

    told: list[str] = []

    def collect(part: Any) -> None:
        for one in part.values() if isinstance(part, dict) else part if isinstance(part, list) else [part]:
            told.append(one) if isinstance(one, str) else collect(one)

    collect(json.loads(Path("tests/data/sentences.json").read_text(encoding="utf-8")))
    with_options = [one for one in told if "--" in one and not one.startswith("rotorfit: ")]
    assert len(with_options) > 30
    for one in with_options:
        assert not re.search(r"--[a-z]", on_the_page(one)), one
    assert on_the_page("two speeds (--per 'K0=speed_rpm'), or one") == "two speeds, or one"


def test_a_seal_rig_is_fitted_with_its_dry_run_by_condition(tmp_path: Path) -> None:
    """As with --baseline and --per; a study that is downloaded names the dry run's file wherever it is run."""
    import panel as pn

    from rotorfit.apps.app.folder import Folder
    from rotorfit.apps.app.forms import model_form
    from rotorfit.apps.app.session import Session, toml_of

    for name in ("wet.csv", "dry.csv"):
        (tmp_path / name).write_text("run\n", encoding="utf-8")
    session = Session(folder=Folder(tmp_path)).with_files(["wet.csv"]).with_model("anisotropic")
    page: Any = SimpleNamespace(session=session, say=lambda words: None)
    page.change_model = lambda asked: setattr(page, "session", asked())
    shown = pn.Column(*model_form(page)[0])
    fields = {field.name: field for field in shown.select(pn.widgets.Widget)}
    fields["dry run of a seal or bearing rig, taken out"].value = "dry.csv"
    next(f for name, f in fields.items() if name.startswith("values by condition")).value = "Kxx=speed_rpm,Kxy=bar"
    assert page.session.content["baseline"] == "dry.csv"
    assert page.session.content["per"] == {"Kxx": "speed_rpm", "Kxy": "bar"}
    assert f'baseline = "{tmp_path / "dry.csv"}"' in toml_of(page.session, absolute=True)
