"""The paper's supervisor and the oracle: actions, observation, rewards, KPIs, as pure functions.

Not the user.
"""
