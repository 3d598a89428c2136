"""
Fig. 10: direct and quadrature dynamic stiffness
================================================

Dynamic stiffness is force over motion, split into the part along the force and the part across it. The direct part is
a parabola, which gives stiffness and masses. The quadrature part is a straight line: its slope is the damping D, and
it is zero at ``lam Om``. At higher speed the oil is warmer and D is smaller, so the quadrature lines are flatter.
"""

import numpy as np

import rotorfit as rf

model = rf.models.OneMode()
truth = {"M": 1.2, "K": 8e3, "Ds": 8.0, "K0": 9e3, "lam": 0.46, "Mf": 0.4}
warmer = {800: 520.0, 1500: 450.0, 2200: 400.0}  # rpm: D, N s/m
rpm = np.linspace(100, 3000, 30)
rpm = np.r_[-rpm[::-1], rpm]
tests = [
    rf.simulate(model, truth | {"D": D}, speed_rpm=speed, frequency_rpm=rpm, unbalance=150e-6, noise=0.01, seed=speed)
    for speed, D in warmer.items()
]

# %%
# All sweeps are fitted with one parameter vector, and ``per`` gives D a value at each speed. Mass, stiffness and
# external damping of the rotor were measured without oil.

fit = rf.fit(model, tests, known={"M": 1.2, "K": 8e3, "Ds": 8.0}, per={"D": "speed_rpm"})
for name, parameter in fit.params.items():
    print(f"{name:<20}{parameter}")
fit.plot.dynamic_stiffness()

# %%
# What to look at: the zeros of the quadrature lines at ``lam Om`` are proportional to the speeds, although D differs.
# The tops of the direct parabolas move with ``lam Om`` too, because of the fluid's inertia Mf. Near zero frequency an
# unbalance gives no force, so the error bars become large.
#
# The cross stiffness
# -------------------
#
# The paper finds that the "cross stiffness" of the fluid is ``K_xy = D lam Om``, and thus has the same origin as the
# damping. These are the fitted values, with errors that respect the correlation of D and lam:

for speed, D in warmer.items():
    cross = fit.derive(lambda p, speed=speed: p.D * p.lam * speed * np.pi / 30, unit="N/m", at={"speed_rpm": speed})
    print(f"{speed} rpm: K_xy = {cross}, truth {D * 0.46 * speed * np.pi / 30:.5g} N/m")
