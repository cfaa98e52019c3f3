"""A town's folder and how its scenario is staged for a world: options, overrides, file names.

Not what the street looks like.
"""
