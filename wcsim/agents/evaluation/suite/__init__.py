"""Suites: fixed lists of test episodes, driven block by block and judged.

What drives is not here.
"""
