"""Figures of responses, stiffness, stability, laws and chains."""
