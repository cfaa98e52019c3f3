"""Play what was driven, or is being driven: a film of light states, a player, sources. How it is made: sources."""
