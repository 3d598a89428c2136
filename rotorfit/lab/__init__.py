"""Files, recordings and virtual rigs become experiments."""
