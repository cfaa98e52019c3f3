"""Opens what a user names: learners, policies, lists of episodes, the street of a block."""
