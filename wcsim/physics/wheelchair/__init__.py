"""The wheelchair: plant, drive controller, wheels, contacts, camera places; no street under it."""
