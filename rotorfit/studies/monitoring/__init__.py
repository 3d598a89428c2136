"""Dated tests of one machine: observed dynamic stiffness and what changes in it."""
