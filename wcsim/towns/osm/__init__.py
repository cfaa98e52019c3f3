"""OpenStreetMap extracts: read, cut and clean them, and the meaning of tags; no nets."""
