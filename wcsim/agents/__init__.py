"""Learning and judging: environments, networks, replay, learners, baselines, evaluation. Read `policy_api.py` first."""
