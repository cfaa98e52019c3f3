"""What the raw map says of a town, counted beside the importer: nothing here shares its code."""
