"""How SUMO's drivers, cyclists and pedestrians react to a wheelchair, and how long vehicles turn.

Pure; no libsumo. `drivers.py` is the driver model: who gives way, who changes lanes. `conflict.py`
has its arithmetic: when bodies meet, and the speed that avoids it. `bridge/sumo/vehicle_control.py`
sends the commands to SUMO.
"""
