"""Network bodies: image and vector to features. `agents/registry.py` says what they must do."""
