"""Tables of text: CSV and Excel files of laboratories and machines, normalised once and read as experiments."""
