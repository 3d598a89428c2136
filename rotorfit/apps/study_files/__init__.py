"""Studies: a fit with its settings in a file and its results in a folder."""
