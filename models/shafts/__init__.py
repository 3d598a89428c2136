"""Shafts: finite elements and their reduction, turning and unequal stiffness, and the lines that these make."""
