"""The size of the project and its ceilings; `python -m tests.api.ceilings` prints them."""
