"""
Figs 13 to 15: larger forces, a nonlinear fluid
===============================================

With a heavier perturbation weight the orbit grows and the film stiffens, so the straight line and the parabola bend
above the whirl resonance. A circular orbit about the centre has a constant radius. Therefore one phasor equation is
exact at every line, with the stiffness at that radius. The difference from the linear rotor is the nonlinear
stiffness.
"""

import numpy as np

import rotorfit as rf

model = rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=80.0)
structure = {"M": 1.2, "K": 3e3, "Ds": 8.0}
fluid = {"K0": 9e3, "D": 450.0, "lam": 0.46, "Mf": 0.4, "n_K": 2.0, "n_D": 1.0, "b": 0.5}
rpm = np.linspace(400, 1500, 27)
rpm = np.r_[-rpm[::-1], rpm]
weights = [20e-6, 50e-6, 90e-6]  # kg m
test = rf.simulate(model, structure | fluid, speed_rpm=1600, frequency_rpm=rpm, unbalance=weights, noise=0.005, seed=1)

# %%
# Figs 13 and 14: the measured stiffness at three weights, with the fit.

fit = rf.fit(model, test, known=structure)
for name, value in fluid.items():
    parameter = fit.params[name]
    print(f"{name:<4} truth {value:6g}   fitted {parameter}")
fit.plot.dynamic_stiffness()

# %%
# Fig. 15: the stiffness of the nonlinear fluid less that of the linear one.

fit.plot.nonlinear_stiffness()

# %%
# The fitted law, with its band. The ticks at the bottom are the eccentricities of the data.

fit.plot.law()

# %%
# What to look at: forward, the curves of the three weights separate above ``lam Om``, where the orbit grows. Backward,
# the orbit stays small and the curves agree. Stiffness over eccentricity (right) is not one curve, because the
# contributions of damping and inertia depend on the frequency too. A linear fit of the same data would give a mean
# over the orbits that were measured. :func:`rotorfit.compare_laws` says whether the data need a law
# (:doc:`/experiments`).
