"""Ways to an error bar: posterior, profile, bootstrap, averages, calibration budget."""
