"""A wheelchair on a test rig, as in ISO 7176: driving, kerbs, ramps, mass rig, tilt table."""
