"""Real processes under random faults, and the proof that no step was lost."""
