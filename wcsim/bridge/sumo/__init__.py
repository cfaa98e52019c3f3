"""SUMO in this process: the only room that speaks to libsumo; values leave it as our types."""
