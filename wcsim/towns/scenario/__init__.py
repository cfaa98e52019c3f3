"""A town's folder and how its scenario is staged for a world: options, overrides, file names.

It knows nothing of what the street looks like.
"""
