"""Driving that is recorded to be learned from: what was seen and done, and what the oracle said of every action."""
