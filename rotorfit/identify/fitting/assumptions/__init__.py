"""Assumptions of a fit, and by how much its numbers would move if they were wrong."""
