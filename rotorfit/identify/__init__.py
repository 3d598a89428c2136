"""Experiments and a model become a fit, its errors and its findings."""
