"""The replay memory of a learner: frames kept once, windows, labels. Not the replay of a recorded world."""
