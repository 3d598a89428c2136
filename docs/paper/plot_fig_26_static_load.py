"""
Figs 26 to 28: static loads
===========================

A constant force pushes the rotating journal, and the journal moves mostly sideways: at small eccentricity the
tangential force ``D lam Om`` is larger than the stiffness. At large eccentricity the film is stiff and lam is small,
so the journal follows the force. The static equation is eq. (13), with the law's values at the eccentricity that is
reached.
"""

import rotorfit as rf

model = rf.models.OneMode(law=rf.models.Muszynska(), clearance_um=200.0)
structure = {"M": 0.4, "K": 0.0, "Ds": 0.0}
fluid = {"K0": 6e3, "D": 300.0, "lam": 0.46, "Mf": 1.5, "n_K": 1.5, "n_D": 0.8, "b": 0.6}
loads = [0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 7.0, 9.0]  # N, straight down
test = rf.simulate(
    model, structure | fluid, "static-load", speed_rpm=[600, 1200, 1800], load=loads, load_deg=-90, noise=0.01, seed=1
)

# %%
# Figs 26 and 28: positions of the journal, with the fitted law. Static loads show only the product ``D lam``.
# Therefore D is given, as from a perturbation test.

fit = rf.fit(model, test, known={**structure, "D": 300.0, "Mf": 1.5})
for name in ("K0", "lam", "n_K", "n_D", "b"):
    parameter = fit.params[name]
    print(f"{name:<4} truth {fluid[name]:6g}   fitted {parameter}")
fit.plot.static_locus()

# %%
# Fig. 27: force over displacement, along and across the load.

fit.plot.static_stiffness()

# %%
# What to look at: at small loads the journal moves at nearly a right angle to the force. It moves at more than a right
# angle if ``Mf (lam Om)^2`` exceeds K0, which happens first at high speed. The quadrature stiffness over speed, ``D
# lam``, lies on one curve for all speeds. The direct stiffness does not, because of the fluid's inertia.
