"""A wheelchair on the test yard, in the manner of ISO 7176: rigs, yard, scales, tilt table."""
