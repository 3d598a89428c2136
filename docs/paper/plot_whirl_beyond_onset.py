"""
Beyond the onset: whirl, whip, side loads
=========================================

The paper describes oil whirl and oil whip, and tests below their onset. If the film stiffens with eccentricity, the
whirl does not grow without limit above the threshold: the journal moves on a circular orbit. Its radius and frequency
follow from the dynamic stiffness, ``kappa(w, Om, eps) = 0``. The fit of a law of eccentricity to tests below the
threshold predicts them.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

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

fit.plot_whirl()

# %%
# A side load raises the threshold, because it holds the journal where the film is stiffer and lam is smaller.

fit.plot_side_load()

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
# A start-up through the onset is integrated in time with a residual unbalance. The cascade shows 1x and the whirl; the
# dotted line is the branch of ``kappa = 0``. The whirl appears later than this branch, because the start-up is faster
# than its growth.

matrices = model.functions
theta, clearance = model.vector(truth), CLEARANCE_UM * 1e-6
first, last, duration = 2000.0, 8000.0, 12.0  # rpm, rpm, s
rate = (last - first) / duration * np.pi / 30


def motion(t, state):
    """Equation of motion at the speed of the moment, the fluid's coefficients at the eccentricity of the moment."""
    z, velocity = state[:2], state[2:]
    speed = first * np.pi / 30 + rate * t
    K, C, M = matrices.values(theta, speed, min(abs(z[1]) / clearance, 0.99))
    force = np.array([2e-5 * speed**2 * np.exp(1j * (first * np.pi / 30 * t + rate * t**2 / 2)), 0])
    return np.concatenate([velocity, np.linalg.solve(M, force - C @ velocity - K @ z)])


t = np.arange(0, duration, 1 / 1000)
z = solve_ivp(motion, (0, duration), np.array([1e-6, 1e-6, 0, 0], complex), t_eval=t, rtol=1e-5, atol=1e-9).y[1]
figure, axis = plt.subplots(figsize=(7, 5.5), layout="constrained")
window = 1024
for begin in range(0, t.size - window, 500):
    piece = z[begin : begin + window] * np.hanning(window)
    size = 2e6 * np.abs(np.fft.fftshift(np.fft.fft(piece))) / window
    w = np.fft.fftshift(np.fft.fftfreq(window, 1 / 1000)) * 60
    speed = first + (last - first) * (t[begin] + 0.5) / duration
    axis.plot(w, speed + 4 * size, "C0", lw=0.7)
branch = rf.models.whirl_branch(model, theta, max_speed=last * np.pi / 30)
axis.plot([5700, 5700], [2600, 2600 + 4 * 100], "k", lw=1.5)
axis.text(5600, 2650, "100 µm 0-pk", ha="right")
axis.plot(branch.frequency * 30 / np.pi, branch.speed * 30 / np.pi, "k:", label="whirl, kappa(w, Om, eps) = 0")
axis.plot([first, last], [first, last], "C1--", lw=0.9, label="1x")
axis.set(xlim=(-2000, 6000), xlabel="frequency, rpm (backward < 0 < forward)", ylabel="rotative speed, rpm")
axis.set_title("start-up through the onset")
axis.legend(loc="upper left")

# %%
# What to look at: the whirl begins with radius zero and grows steeply. Its frequency departs from the straight line of
# the onset's ratio and levels off. ``rf.models.whirl_branch`` also says where an orbit is unstable. The branch of a
# rotor may fold back: then the rotor runs quietly again above the fold, and below it either rests or whirls, depending
# on how it started.
