"""What stands on the ground: buildings, signals, stops, trees, an author's obstacles."""
