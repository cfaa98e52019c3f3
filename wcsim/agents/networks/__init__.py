"""Network bodies by name, and the Q network made of them. A new network is a file here and a line in `registry.py`."""
