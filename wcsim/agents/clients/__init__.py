"""Learners as clients of a shared world, each in a process of its own."""
