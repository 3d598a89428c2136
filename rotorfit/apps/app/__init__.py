"""The front in a browser: views of the data, of a study and of its results, served to this machine alone."""
