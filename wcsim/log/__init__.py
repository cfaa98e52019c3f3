"""The log: one format for all recordings of a world, its writer and its readers; no simulator."""
