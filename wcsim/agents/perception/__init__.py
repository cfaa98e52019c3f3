"""The street as a chair senses it, how the chair moves, when its user is warned: shared by policies and learners."""
