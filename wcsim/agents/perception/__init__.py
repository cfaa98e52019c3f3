"""The street as a chair senses it, how the chair moves, and when its user is warned."""
