"""Learning and judging: environments, networks, learners, baselines. Read `policy_api.py` first."""
