"""Files: reading and writing experiments in CSV, UFF58, netCDF and MAT."""
