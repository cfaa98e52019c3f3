"""How SUMO's drivers, cyclists and pedestrians react to a wheelchair.

And how long vehicles keep off the pavement. Pure; no libsumo.
"""
