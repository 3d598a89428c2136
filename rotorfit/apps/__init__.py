"""Programs: the command line, the front in a browser, the store, studies in files."""
