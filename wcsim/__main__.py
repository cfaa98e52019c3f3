"""`python -m wcsim` is the `wcsim` command."""

from wcsim.cli.main import main

if __name__ == "__main__":
    raise SystemExit(main())
