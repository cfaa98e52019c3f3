"""A danger network that learns step by step as it drives, behind an environment that tells the truth. Not in rounds."""
