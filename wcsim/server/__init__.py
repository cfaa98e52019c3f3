"""Several clients in one world: protocol, barrier, journal, links, processes. No learning."""
