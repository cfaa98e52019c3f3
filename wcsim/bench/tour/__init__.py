"""A chair over every pavement, walking area and crossing of a town."""
