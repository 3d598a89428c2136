"""Inference from the data: covariance, identifiability, profiles, score tests, posteriors."""
