"""Commands about towns: import, make, check, pave, run."""
