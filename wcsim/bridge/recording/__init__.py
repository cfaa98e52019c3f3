"""Traces of a world on disk: written, read, compared, as SUMO's floating car data. Not the barrier's journal."""
