"""Stability of a fitted rotor at running speed."""
