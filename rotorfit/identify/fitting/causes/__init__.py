"""Causes beside the model: their list with sizes, their solution with the fitted values, their effect on results."""
