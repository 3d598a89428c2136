"""Motion that follows from the equation of a model: stability, equilibria and orbits, and which terms it neglects."""
