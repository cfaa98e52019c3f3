"""Commands about towns: import, check, pave, run, tour."""
