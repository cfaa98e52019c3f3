"""Play what was or is being driven: a film of light states, its player and its sources."""
