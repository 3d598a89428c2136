"""Tests and fits of machines in one file, kept up as tests arrive: the store, the watch over a folder, its page."""
