"""Tests of what makes pages and tables: the scripts in `tools/`."""
