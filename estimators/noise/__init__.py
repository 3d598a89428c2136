"""How large errors are: from repeats, from smoothness, from residuals, from what differs between runs and mountings."""
