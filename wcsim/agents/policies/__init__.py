"""Policies that learn nothing: follow, dwa, oracle and their kin. Trained ones are read from run folders."""
