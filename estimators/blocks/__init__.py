"""Measured readings in a model's coordinates, a block for each kind of test, and what a model predicts for them."""
