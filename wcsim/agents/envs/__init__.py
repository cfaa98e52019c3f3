"""Gymnasium, PettingZoo and Stable-Baselines3 interfaces of a wheelchair. No learner."""
