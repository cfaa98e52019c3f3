"""Crashes looked at one by one: class, place, cause, and how often."""
