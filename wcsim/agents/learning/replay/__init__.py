"""The replay memory of a learner: frames stored once, windows, labels. Not the replay of a recorded world."""
