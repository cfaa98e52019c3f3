"""The scripts of `python -m benchmarks`: each prints a table, and writes it as JSON."""
