"""Pavements for a scenario that has none; its stops, detectors and signal programs stay."""
