"""A town is made here: import of a map, adoption of a scenario, net, elevation, demand, parking.

Not used by a running world.
"""
