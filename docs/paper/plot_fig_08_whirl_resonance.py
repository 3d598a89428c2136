"""
Figs 8 and 9: the whirl resonance
=================================

A forward force excites a resonance at ``lam Om``, slightly below half the rotative speed. A backward force excites
none. The fluid causes this resonance: it moves with the speed and vanishes at standstill. Its amplitude grows as the
threshold of stability comes nearer, and added mass brings the threshold nearer.
"""

import matplotlib.pyplot as plt
import numpy as np

import rotorfit as rf

RPM = 30 / np.pi
model = rf.models.OneMode()
original = {"M": 1.2, "K": 3e3, "Ds": 8.0, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}
variants = {
    "O: original": original,
    "S: added springs": original | {"K": 12e3},
    "M: added mass": original | {"M": 2.0},
    "SM: both": original | {"K": 12e3, "M": 2.0},
}
rpm = np.linspace(100, 3000, 40)


def bode(axes, test, scale, label):
    """Amplitude and phase of the journal's x probe over frequency."""
    at = np.argsort(abs(test.frequency))
    here = at[test.direction[at] == "x"]
    response = test.response[here] / (test.force[here] / abs(test.force[here]))
    axes[0].plot(abs(test.frequency[here]) * scale, np.degrees(np.unwrap(np.angle(response))), ".-", ms=3, label=label)
    axes[1].plot(abs(test.frequency[here]) * scale, 1e6 * abs(response), ".-", ms=3, label=label)


# %%
# Fig. 8: four rotors at 1400 rpm, perturbed forward (left) and in reverse (right).

figure, axes = plt.subplots(2, 2, figsize=(9, 6), sharex=True, sharey="row", layout="constrained")
for name, values in variants.items():
    for column, sign in enumerate((1, -1)):
        test = rf.simulate(model, values, speed_rpm=1400, frequency_rpm=sign * rpm, unbalance=6e-6, noise=0.005, seed=1)
        bode(axes[:, column], test, RPM, name)
axes[0, 0].set(title="forward perturbation", ylabel="phase lead, deg")
axes[0, 1].set(title="reverse perturbation")
axes[1, 0].set(ylabel="amplitude, µm 0-pk", xlabel="perturbation frequency, rpm")
axes[1, 1].set(xlabel="perturbation frequency, rpm")
for axis in axes[:, 0]:
    axis.axvline(0.46 * 1400, color="0.4", ls=":", label="lam Om")
axes[0, 0].legend(fontsize=8)

# %%
# Fig. 9: the same over the ratio of perturbation frequency to rotative speed. The peaks stay near lam and grow with the
# speed.

figure, axes = plt.subplots(2, 1, figsize=(7, 6), sharex=True, layout="constrained")
for speed_rpm in (900, 1300, 1600, 1900):
    test = rf.simulate(model, original, speed_rpm=speed_rpm, frequency_rpm=rpm, unbalance=6e-6, noise=0.005, seed=2)
    bode(axes, test, RPM / speed_rpm, f"{speed_rpm} rpm")
axes[0].set(ylabel="phase lead, deg", title="forward perturbation at four rotative speeds")
axes[1].set(xlabel="perturbation frequency over rotative speed", ylabel="amplitude, µm 0-pk", xlim=(0, 1.6))
for axis in axes:
    axis.axvline(0.46, color="0.4", ls=":", label="lam")
axes[0].legend()

# %%
# A fit draws both figures. The first shows forward and reverse in one panel (reverse dashed and open), with the
# amplitudes for the unbalance of the test. The second uses the ratio of perturbation frequency to rotative speed.

tests = [
    rf.simulate(
        model, original, speed_rpm=speed, frequency_rpm=np.r_[-rpm[::-1], rpm], unbalance=6e-6, noise=0.005, seed=speed
    )
    for speed in (900, 1600)
]
fit = rf.fit(model, tests, known={"K": 3e3, "Ds": 8.0})
fit.plot.bode(against="size", mr=6e-6)

# %%

fit.plot.bode(against="ratio", mr=6e-6)

# %%
# What to look at: at ``lam Om`` (dotted) the phase passes zero, from lead to lag. At a mechanical resonance it would
# lag by 90 degrees. The whirl resonance occurs where the quadrature stiffness vanishes, not the direct stiffness.
# Below it, the amplitude under an unbalance grows with the square of the frequency. These are the thresholds of the
# four rotors:

for name, values in variants.items():
    onset = rf.models.threshold_speed(model, model.vector(values))
    print(f"{name:<18}threshold {onset.speed * RPM:6.0f} rpm, whirl ratio there {onset.whirl_ratio:.3f}")
