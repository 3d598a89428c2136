"""Errors of the data: those that show before a fit, and those that a fit shows."""
