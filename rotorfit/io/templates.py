"""Example files of every kind of experiment, with comments, to fill in: ``rotorfit template KIND``."""

from __future__ import annotations

from rotorfit.models.parameters import unknown_name

_UNITS = """\
# The end of a name is the unit: frequency and speed _rpm, _hz, _rad_s, _cpm; amplitude _um, _um_pp, _mil_pp, _mm, _m;
# force _N, _lbf; phase_deg leads, phase_lag_deg lags. Amplitudes are 0-peak unless the name ends in _pp or _rms.
# Further columns (oil_C, pressure_bar, ...) are kept as conditions of the test. Lines with # are comments.
"""

_PERTURBATION = """\
# Nonsynchronous perturbation test: one row is one probe reading in one run at one frequency.
# run            name of the sweep; a run has one force. Left out: one for each forced plane and speed.
# frequency_rpm  of the perturbation, negative for backward whirl.
# force_N        size of the rotating force, or in its place an unbalance mr_g_mm (mr_kg_m, mr_oz_in).
# force_angle_deg  where the force points at the time of the phase mark, from x towards y, forward and backward alike;
#                or in its place force_phase_deg, the lead in time of its x component (backward minus the angle).
# plane, direction  where the probe is; x or y (one probe), or z = x + jy already combined.
# sigma_um       standard deviation of real and imaginary part of the reading; may be left out.
# force_direction  circular (left out: that), or x, y for a shaker or one axis of a magnetic bearing.
"""
_PERTURBATION_ROWS = """\
run,speed_rpm,frequency_rpm,force_plane,force_N,force_angle_deg,plane,direction,amplitude_um,phase_deg,oil_C
forward,1500,600,journal,2.0,30,journal,x,41.2,-18.5,45.1
forward,1500,600,journal,2.0,30,journal,y,40.9,-108.9,45.1
forward,1500,900,journal,2.0,30,journal,x,55.6,-61.0,45.2
forward,1500,900,journal,2.0,30,journal,y,55.1,-151.3,45.2
backward,1500,-600,journal,2.0,30,journal,x,22.4,51.7,45.3
backward,1500,-600,journal,2.0,30,journal,y,22.6,141.2,45.3
backward,1500,-900,journal,2.0,30,journal,x,15.8,61.9,45.3
backward,1500,-900,journal,2.0,30,journal,y,15.7,152.4,45.3
"""
_WIDE = """\
# Perturbation test as analysers export it: one row a frequency, a column a probe.
# <plane>_<x|y>_<unit> is an amplitude, <plane>_<x|y>_lag_deg (or _deg, which leads) its phase; empty cells are skipped.
# Other names: tell them in the study, files = [{path = "this.csv", columns = {"Ampl. 1X" = "journal_x_um_pp"}}],
# and what the table does not say, constants = {force_plane = "journal", speed_rpm = 1500}.
"""
_WIDE_ROWS = """\
run,speed_rpm,frequency_rpm,force_plane,mr_g_mm,force_angle_deg,disk_x_um,disk_x_lag_deg,disk_y_um,disk_y_lag_deg
forward,1500,600,disk,150,30,12.2,18.5,12.1,108.9
forward,1500,900,disk,150,30,37.0,61.0,36.7,151.3
backward,1500,-600,disk,150,30,6.6,-51.7,6.7,-141.2
backward,1500,-900,disk,150,30,10.5,-61.9,,
"""
_SYNCHRONOUS = """\
# Synchronous test: start-ups or shut-downs with a calibration weight, frequency = speed on every row.
# Each plane is run with the weight at an angle and turned by 180 degrees; half the difference is what is fitted, so
# that residual unbalance, bow and run-out drop out. force_phase_deg is the angle of the weight from the mark.
# Weights that are in at once (a trial weight that was kept): a row for each, with the same reading.
"""
_DISPLACEMENT = """\
# A circular orbit is imposed (squeeze film, seal rig) and the forces along x and y are measured: one row a frequency.
# amplitude_um is the radius of the orbit; sigma_N may be left out.
run,speed_rpm,frequency_rpm,plane,amplitude_um,phase_deg,force_x_N,force_x_phase_deg,force_y_N,force_y_phase_deg
forward,1500,600,journal,30,0,0.52,42.0,0.51,-48.3
forward,1500,900,journal,30,0,0.80,57.2,0.81,-33.0
backward,1500,-600,journal,30,0,0.95,-68.1,0.94,21.7
backward,1500,-900,journal,30,0,1.25,-74.0,1.26,15.8
"""
_STATIC = """\
# Constant loads on the turning shaft: one row a load. load_deg is the direction of the load from x towards y; x_um and
# y_um are the journal's position relative to that without load. plane and load_plane are the journal unless columns
# say more.
run,speed_rpm,load_N,load_deg,x_um,y_um
r1,1500,0.5,-90,11.5,-30.1
r1,1500,1.0,-90,22.0,-61.0
r1,1500,2.0,-90,38.5,-110.2
"""
_IMPULSE = """\
# Free vibration after an impulse: frequency and damping of the mode, one row an impulse, at the journal's eccentricity
# over the clearance (or its position x_um, y_um). sigma_rpm, of the frequency, may be left out.
run,speed_rpm,frequency_rpm,damping_ratio,eccentricity_ratio
r1,1500,712,0.21,0.05
r1,1500,735,0.24,0.25
r1,1500,802,0.30,0.50
"""
_COEFFICIENTS = """\
# Coefficients of a seal or bearing from other work or computation, one row a speed and eccentricity.
speed_rpm,eccentricity_ratio,kxx_N_m,kxy_N_m,cxx_N_s_m,cxy_N_s_m,mxx_kg
1500,0.0,9000,32000,450,55,0.4
1500,0.2,9800,32800,470,56,0.4
1500,0.4,13000,35900,560,60,0.4
"""
_STUDY = """\
# A study: rotorfit run study.toml. Paths are relative to this file.
files = [
  "rig.csv",
  # {path = "other.xlsx", sheet = "run 2", where = {oil_C = {from = 40, to = 60}}, exclude = {run = ["r07"]}},
  # {path = "wide.csv", constants = {speed_rpm = 1500}, columns = {"Ampl." = "journal_x_um"}, drop_near_1x = 0.05},
]
model = "whirl-whip"             # see `rotorfit models`
out = "results"
known = {K3 = 6000.0}            # not fitted, SI units
# bounds = {lam = [0.0, 0.6]}
# priors = {sigma = {norm = [1.0, 0.01]}}
# per = {D = "speed_rpm"}        # a value of its own for each speed
# refine = true                  # structural blocks, as far as the data ask for them
# sample = true                  # the posterior
# profile = ["lam", "threshold_speed"]
"""


def _ring_down() -> str:
    """A decaying orbit of 12 samples a turn."""
    import math

    lines = [
        "# Records of free vibration after an impulse: one row a sample, one run a record, sampled evenly.",
        "run,speed_rpm,time_s,x_um,y_um",
    ]
    for k in range(120):
        size, angle = 40.0 * math.exp(-25.0 * k / 1000), 2 * math.pi * 12.0 * k / 1000
        lines.append(f"r1,1500,{k / 1000:g},{size * math.cos(angle):.4g},{size * math.sin(angle):.4g}")
    return "\n".join(lines) + "\n"


def _start_ups() -> str:
    """Two start-ups with the weight at 0 and at 180 degrees."""
    lines = [
        "run,speed_rpm,frequency_rpm,force_plane,mr_g_mm,force_phase_deg,plane,direction,amplitude_um,phase_lag_deg"
    ]
    for run, angle, lag in (("at 0", 0, 35.0), ("at 180", 180, 210.0)):
        for step in range(16):
            rpm = 400 + 40 * step
            for direction, turn in (("x", 0.0), ("y", 90.0)):
                size = 10.0 * (rpm / 1000) ** 2 * (1.0 if angle else 1.3)
                lines.append(
                    f"{run},{rpm},{rpm},inboard,200,{angle},inboard,{direction},{size:.4g},{lag + turn + 2 * step:g}"
                )
    return "\n".join(lines) + "\n"


def kinds() -> tuple[str, ...]:
    """Names of the templates."""
    return tuple(_texts())


def _texts() -> dict[str, str]:
    return {
        "perturbation": _PERTURBATION + _UNITS + _PERTURBATION_ROWS,
        "wide": _WIDE + _UNITS + _WIDE_ROWS,
        "synchronous": _SYNCHRONOUS + _UNITS + _start_ups(),
        "displacement": _UNITS + _DISPLACEMENT,
        "static-load": _UNITS + _STATIC,
        "impulse": _IMPULSE,
        "ring-down": _ring_down(),
        "coefficients": _COEFFICIENTS,
        "study": _STUDY,
    }


def example(kind: str) -> str:
    """Text of an example file."""
    texts = _texts()
    if kind not in texts:
        raise ValueError(unknown_name("kind of file", kind, texts))
    return texts[kind]
