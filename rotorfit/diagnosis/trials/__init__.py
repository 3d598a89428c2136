"""Errors of the data that only a fit gives away: each is undone, and what that leaves is compared."""
