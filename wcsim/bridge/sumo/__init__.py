"""SUMO in this process: the only room that speaks to libsumo.

Values come out of it as our types.
"""
