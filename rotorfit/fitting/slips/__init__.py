"""What a far misfit may come from in the data: slips that only a fit gives away, each undone and tried."""
