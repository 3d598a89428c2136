"""The options of an identification: each described once, read from words and from TOML, written back as words."""
