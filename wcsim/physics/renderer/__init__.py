"""The rasteriser: depth, classes and colours of what a camera sees, on the CPU.

What a sensor makes of it is in `sensors`.
"""
