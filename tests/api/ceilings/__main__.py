"""Prints the table of ceilings; 1 when one is broken."""

from tests.api.ceilings.table import main

if __name__ == "__main__":
    raise SystemExit(main())
