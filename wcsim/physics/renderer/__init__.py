"""Depth, classes and colours of what a camera sees, drawn on the CPU by the rasteriser.

What a sensor makes of it is in `sensors`.
"""
