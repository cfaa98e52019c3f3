"""Observation, rewards, KPIs, the simulated user and the oracle: pure functions over `types`."""
