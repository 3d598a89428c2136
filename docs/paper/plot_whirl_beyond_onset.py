"""
Beyond the onset: whirl, whip, side loads
=========================================

The paper describes oil whirl and oil whip, and tests below their onset. If the film stiffens with eccentricity, the
whirl does not grow without limit above the threshold: the journal moves on a circular orbit. Its radius and frequency
follow from the dynamic stiffness, ``kappa(w, Om, eps) = 0``. The fit of a law of eccentricity to tests below the
threshold predicts them.
"""

import tempfile
from pathlib import Path

import numpy as np

import rotorfit as rf

CLEARANCE_UM = 200.0
law = rf.models.Muszynska()
bearing = rf.models.OneMode(law=law, clearance_um=CLEARANCE_UM)
values = {
    "M": 1.2,
    "K": 2e3,
    "Ds": 8.0,
    "K0": 9e3,
    "D": 450.0,
    "lam": 0.46,
    "Mf": 0.4,
    "n_K": 2.0,
    "n_D": 1.4,
    "b": 0.5,
}
rpm = np.r_[-1500:-99:200, 100:1600:100]
test = rf.simulate(bearing, values, speed_rpm=1200, frequency_rpm=rpm, force=[0.5, 3.0], noise=0.01, seed=4)
fit = rf.fit(bearing, test, known={"K": 2e3, "Ds": 8.0})
print("threshold", fit.threshold_speed().to("rpm"))

# %%
# This figure shows the radius and frequency of the whirl that the fit predicts from a test at 1200 rpm. At the onset
# the frequency is about lam times the speed. At higher speed the eccentricity reduces lam, and the ratio falls.

fit.plot.whirl()

# %%
# A side load raises the threshold, because it holds the journal where the film is stiffer and lam is smaller.

fit.plot.side_load()

# %%
# Whirl to whip
# -------------
#
# With a flexible shaft and a disk, the frequency of the whirl approaches the bending frequency and stays there. This
# is whip.

model = rf.models.WhirlWhip(law=law, clearance_um=CLEARANCE_UM)
truth = {
    "Md": 0.95, "Ds": 3.0, "K1": 14e3, "K2": 15e3, "sigma": 1.0, "Mb": 0.3, "K3": 6e3, "K0": 1e4, "D": 450.0,
    "lam": 0.475, "Mf": 0.35, "n_K": 2.0, "n_D": 1.4, "b": 0.5,
}  # fmt: skip

# %%
# A start-up through the onset, as it would be recorded: the rotor with its residual unbalance is integrated in time and
# read by probes in volts. The dotted line over the cascade is the branch of ``kappa = 0``. The whirl appears later than
# this branch, because the start-up is faster than its growth.

folder = Path(tempfile.mkdtemp())
start_up = {
    "kind": "synchronous", "speed_rpm": (2000, 7000), "duration": 10, "unbalance": 2e-5, "planes": "disk",
    "hole_deg": [0], "instruments": rf.Instruments(sample_rate=4000),
}  # fmt: skip
(file,) = rf.simulate_recordings(model, truth, folder, **start_up)
branch = rf.models.whirl_branch(model, model.vector(truth), max_speed=7000 * np.pi / 30)


def with_branch(cascade):
    """The cascade with the whirl that the dynamic stiffness gives."""
    (axis,) = cascade.axes
    style = {"color": "k", "ls": ":", "zorder": 1000, "label": "whirl, kappa(w, Om, eps) = 0"}
    axis.plot(branch.frequency / (2 * np.pi), branch.speed * 30 / np.pi, **style)
    axis.legend(loc="upper left", fontsize=8)
    return cascade


with_branch(rf.read_recording(file).plot.cascade("journal", limit_hz=100))

# %%
# The flow of a real machine is turbulent, and shakes the rotor at all frequencies. The whirl then has something to grow
# from, and begins at the threshold speed. Here is the same start-up with a random force of 0.02 N per root Hz on each
# plane. It moves the journal by some micrometres below the threshold:

(file,) = rf.simulate_recordings(model, truth, folder / "turbulent", turbulence=0.02, **start_up)
with_branch(rf.read_recording(file).plot.cascade("journal", limit_hz=100))

# %%
# A real rotor whips earlier than an ideal start-up says: a start-up without whirl proves a threshold only where
# something shakes the rotor.
#
# What to look at: the whirl begins with radius zero and grows steeply. Its frequency departs from the straight line of
# the onset's ratio and levels off. ``rf.models.whirl_branch`` also says where an orbit is unstable. The branch of a
# rotor may fold back: then the rotor runs quietly again above the fold, and below it either rests or whirls, depending
# on how it started.
