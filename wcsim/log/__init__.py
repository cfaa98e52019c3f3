"""The log: one format for all that is recorded of a world, its writer and its readers. It knows no simulator."""
