"""The replay memory of a learner: frames, windows, labels. Not the replay of a recorded world."""
