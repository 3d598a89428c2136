"""Setups of the virtual shaft's recordings: its two probes, with and without a perturbator and a twist."""

PROBES = """rotation = "ccw"
[shaft]
channel = "keyphasor_shaft"
[[probe]]
plane = "disk"
channel = "disk_X"
angle_deg = 0.0
[[probe]]
plane = "disk"
channel = "disk_Y"
angle_deg = 90.0
"""

PERTURBED = (
    PROBES
    + """[perturbator]
channel = "keyphasor_perturbator"
[force]
plane = "disk"
"""
)

TWISTED = (
    PERTURBED
    + """[twist]
channel = "twist"
sensitivity_V_per_rad = 1000.0
"""
)
