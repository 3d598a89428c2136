"""What a fit finds of its noise: runs that differ, noise that rises with the response, channels that fail."""
