"""Offline: import OpenStreetMap and SUMO towns, check them, and make their street mesh and walk graph."""
