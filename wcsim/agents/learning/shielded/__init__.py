"""Q-learning on top of a danger network that stays as it is: it forbids, and rewards choose among what it allows."""
