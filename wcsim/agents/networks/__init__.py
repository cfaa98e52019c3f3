"""Network bodies by name, and the Q network made of them.

A new network is a file here, a line in `names.py` and one in `registry.py`.
"""
