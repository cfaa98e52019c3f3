"""Trials of a plant in the manner of ISO 7176: each drives, tilts or weighs one chair and gives one number."""
