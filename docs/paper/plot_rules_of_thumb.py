"""
Rules of thumb and fitted numbers
=================================

The paper's rule for the threshold of stability is ``sqrt((K + K0)/M)/lam``, the speed at which ``lam Om`` reaches the
natural frequency. It holds for one mode without external damping, whatever the fluid's inertia is. External damping
raises the threshold. With two modes, the lowest natural frequency of the whole rotor takes the place of ``sqrt((K +
K0)/M)``.
"""

import matplotlib.pyplot as plt
import numpy as np

import rotorfit as rf

RPM = 30 / np.pi
model = rf.models.OneMode()
truth = {"M": 1.2, "K": 8e3, "Ds": 0.0, "K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4}

# %%
# The figure compares the rule with the eigenvalues of the equation of motion, over external damping. With ``r = Ds/D``
# the exact threshold of one mode is ``(1 + r)/lam sqrt((K + K0)/(M + Mf r²))``.

shares = np.linspace(0, 0.6, 25)
rule = np.sqrt((truth["K"] + truth["K0"]) / truth["M"]) / truth["lam"] * RPM
exact = [(1 + r) / 0.46 * np.sqrt(17e3 / (1.2 + 0.4 * r**2)) * RPM for r in shares]
computed = [rf.models.threshold_speed(model, model.vector(truth | {"Ds": r * truth["D"]})).speed * RPM for r in shares]
figure, axis = plt.subplots(figsize=(7, 4), layout="constrained")
axis.axhline(rule, color="C3", ls="--", label="rule of thumb: sqrt((K + K0)/M)/lam")
axis.plot(shares, exact, label="with external damping, in closed form")
axis.plot(shares, computed, "k.", label="eigenvalues")
axis.set(
    xlabel="external damping over the fluid's, Ds/D", ylabel="threshold speed, rpm", title="threshold of stability"
)
axis.legend()

# %%
# The same from a test, with errors. ``derive`` computes a quantity from parameters and respects their correlations.

rpm = np.r_[np.linspace(-2500, -100, 25), np.linspace(100, 2500, 25)]
damped = truth | {"Ds": 8.0}
test = rf.simulate(model, damped, speed_rpm=[800, 1600], frequency_rpm=rpm, force=5.0, noise=0.01, seed=1)
fit = rf.fit(model, test, known={"K": 8e3, "M": 1.2, "Ds": 8.0})
thumb = fit.derive(lambda p: ((8e3 + p.K0) / 1.2) ** 0.5 / p.lam, unit="rad/s")
print("rule of thumb   ", thumb.to("rpm"))
print("from eigenvalues", fit.threshold_speed().to("rpm"))
print("truth           ", f"{rf.models.threshold_speed(model, model.vector(damped)).speed * RPM:.0f} rpm")

# %%
# What to look at: the dashed line is a lower bound, and a rotor with little external damping is near it. The page of
# Fig. 10 shows the cross stiffness ``K_xy = D lam Om``.
