"""Gymnasium environment, networks, learning, baselines, train and test."""
