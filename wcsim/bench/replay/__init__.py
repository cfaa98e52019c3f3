"""What a state costs in the replay memory: bytes on disk, time to write and to read."""
