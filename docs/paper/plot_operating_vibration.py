"""
Operating vibration: damping without an exciter
===============================================

The paper forces a rotor by a perturbator. The flow forces it as well, at all frequencies, by its turbulence. The
spectrum of ``z = x + jy`` is then ``|H(w)|^2`` times that of the force, and ``H = 1 / kappa(w, Om)`` is the paper's:
forward and backward whirl stand at either side of zero. Here a rotor with one mode runs for three minutes.
"""

import tempfile

import numpy as np

import rotorfit as rf

model = rf.models.OneMode()
truth = {"M": 1.0, "K": 8000.0, "Ds": 5.0, "K0": 3000.0, "D": 400.0, "lam": 0.40, "Mf": 0.2}
onset = rf.models.threshold_speed(model, model.vector(truth)).speed
(file,) = rf.simulate_recordings(
    model, truth, tempfile.mkdtemp(), "operating", speed=220.0, duration=180, turbulence=0.05, residual=2e-6,
    instruments=rf.Instruments(sample_rate=1600.0), seed=2,
)  # fmt: skip
test = rf.operating_spectra(rf.read_recording(file), band_hz=(1, 60))

# %%
# The mass of the rotor, its stiffness and damping outside the fluid are given to the fit. The spectrum of the force is
# found with the fluid.

fit = rf.fit(model, test, known={"M": 1.0, "K": 8000.0, "Ds": 5.0})
print(f"threshold {fit.threshold_speed().to('rpm')}, true {onset * 30 / np.pi:.0f} rpm")
print("lam", fit.params["lam"], " true", truth["lam"])

# %%
# Forward whirl, right of zero, has a peak. Its width is the damping that is left at this speed. Backward whirl is
# damped away.

fit.plot.spectra(unit="hz")

# %%
# The same damping against speed, with the threshold where it is used up.

fit.plot.stability()

# %%
# Forward and backward are not related in a round rotor that is shaken alike in x and y. Anisotropy of the supports
# would lift the coherence of the two above its band.

test.plot.coherence(unit="hz")
