"""
Figs 37 and 38: a shaft that is not round, and its twist
========================================================

Two flats make the shaft stiffer one way than the other, and that turns with it. A backward force at w then
moves the shaft at w and at ``2 Om - w``, and together with unbalance and side load it twists the shaft: at
``w - Om``, ``w - 2 Om`` and twice the first. Where one of these meets the torsional natural frequency the
twist resonates.
"""

import tempfile
from pathlib import Path

import rotorfit as rf
from rotorfit.simulation.shaft import Perturbation
from rotorfit.simulation.shaft_record import Acquisition, record_shaft

shaft = rf.models.AnisotropicShaft()
truth = {
    "M": 1.0, "D": 6.0, "K": 4e4, **shaft.components(dK=2000.0, angle=0.6), "ec": 6e-5, "es": 0.0,
    "Px": 0.0, "Py": -8.0, "J": 2e-4, "nu_t": 340.0, "zeta_t": 0.01,
}  # fmt: skip
folder = Path(tempfile.mkdtemp())
sweep = Perturbation(mr=3e-5, first=20.0, last=320.0)  # kg m, rad/s, backward
record_shaft(
    folder / "shaft.h5", shaft, truth, 120.0, 15.0, perturbation=sweep, acquisition=Acquisition(sample_rate=2000.0)
)
(folder / "rig.toml").write_text(
    """
rotation = "ccw"
[shaft]
channel = "keyphasor_shaft"
[perturbator]
channel = "keyphasor_perturbator"
[[probe]]
plane = "disk"
channel = "disk_X"
angle_deg = 0.0
[[probe]]
plane = "disk"
channel = "disk_Y"
angle_deg = 90.0
[force]
plane = "disk"
[twist]
channel = "twist"
sensitivity_V_per_rad = 1000.0
"""
)
record = rf.read_recording(folder / "shaft.h5", folder / "rig.toml")

# %%
# Fig. 37: spectra of the vertical vibration while the perturbation sweeps backward, 15 s of volts. Beside the lines
# that are always marked, the two that the paper found.

record.plot_cascade(lines={"w − 1x": (1, -1), "2w − 1x": (2, -1)})

# %%
# Fig. 38: overall amplitude of the twist over the perturbation frequency, and its spectra. Dotted: the torsional
# natural frequency and its half.

record.plot_twist(marks={"ν_t": truth["nu_t"], "ν_t/2": truth["nu_t"] / 2})

# %%
# The lines are fitted together: M, K and D from the line at w, dK and its direction from the image at ``2 Om -
# w``, the torsional frequency and damping from the twist.

fit = rf.fit(shaft, rf.shaft_lines(record), known={"J": 2e-4})
for name in ("M", "K", "D", "nu_t", "zeta_t"):
    parameter = fit.params[name]
    print(
        f"{name:<7} truth {truth[name]:6g}   fitted {parameter.value:9.5g} +- {parameter.stderr:.2g} {parameter.unit}"
    )
found = fit.turning_anisotropy()
print(f"dK      truth   2000   fitted {found.dK.value:9.5g} +- {found.dK.stderr:.2g} N/m")
fit.plot_lines()

# %%
# What to look at: slanted ridges are lines that follow the perturbation, upright ones belong to the shaft's own
# orders. The twist has two peaks side by side: the lateral resonance near 1910 rpm, and 2101 rpm, where ``|w| +
# Om`` is the torsional frequency, 3247 rpm. A crack is a dK that grows; :doc:`/anisotropic_shaft` follows one.
