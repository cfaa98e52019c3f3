"""Clusters on one machine: nodes, their network, small pieces of work."""
