"""Towns: from OpenStreetMap or a SUMO scenario to a street that wheels and cameras can use.

Read `street.py` first. No simulator runs here.
"""
