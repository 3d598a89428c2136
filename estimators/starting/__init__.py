"""Estimates without iteration, and where an optimisation begins."""
