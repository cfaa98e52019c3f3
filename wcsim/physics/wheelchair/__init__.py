"""The wheelchair: plant, drive controller, wheels, contacts, where its cameras sit. Not the street under it."""
