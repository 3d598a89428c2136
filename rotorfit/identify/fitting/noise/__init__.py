"""The noise of a fit: runs that differ, noise that rises with the response, channels that fail."""
