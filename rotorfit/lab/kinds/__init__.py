"""Kinds of experiments other than responses to forces: what each holds, how a model sees it, what it shows."""
