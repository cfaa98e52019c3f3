"""Commands that train: train, join, demo, several clients."""
