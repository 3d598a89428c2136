"""What every storey uses: array types, names, digits, tables of text, units, files, statistics of a line or two."""
