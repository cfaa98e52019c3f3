"""Pavements and crossings for a scenario that has none, with its own stops, detectors and signal programs kept."""
