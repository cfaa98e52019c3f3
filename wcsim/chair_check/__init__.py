"""A wheelchair on a test rig, in the manner of ISO 7176: driving, kerbs, ramps, mass rig, tilt table."""
