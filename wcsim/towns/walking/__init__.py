"""Where one can walk or roll: graph, routes, islands, lines of sight. Not who does."""
