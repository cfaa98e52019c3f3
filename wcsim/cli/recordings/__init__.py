"""Commands for recordings: log, replay, watch, and users that are recorded and fitted."""
