"""Run folders of trainings: manifest, settings, checkpoints, logs, policy files; recorded data."""
