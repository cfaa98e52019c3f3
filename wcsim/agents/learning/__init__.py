"""SeqDQN and a training run: phases, losses, replay memory, callbacks, checkpoints, policies."""
