"""SeqDQN and a training run: phases, losses, callbacks, checkpoints, saved policies. Not environments."""
