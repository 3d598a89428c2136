"""Matrices of shafts that other programs made, and elements for these."""
