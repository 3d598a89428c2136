"""From experiments to the complex readings that a fit explains."""
