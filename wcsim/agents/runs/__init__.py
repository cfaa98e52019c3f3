"""Run folders of training: manifest, configuration, policy files, whose own code they name; recorded data."""
