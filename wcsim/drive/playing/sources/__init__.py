"""Sources of films: a log's states, a replayed log, a growing run, episodes; each a process."""
