"""Families of generated scenes, each a danger that a helper can avoid, drawn from a seed; not what opens a scene."""
