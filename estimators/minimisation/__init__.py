"""The smallest misfit: least squares by Ipopt, one fit or many at once."""
