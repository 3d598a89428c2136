"""What the data determine and how well: covariance, identifiability, profiles, score tests, posteriors."""
