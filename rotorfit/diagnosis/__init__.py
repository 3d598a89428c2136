"""What looks wrong with the data, before anything is fitted."""
