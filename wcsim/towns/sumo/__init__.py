"""SUMO's files and tools: nets, additional files, XML, netconvert and its sisters as children.

No SUMO runs in this process.
"""
