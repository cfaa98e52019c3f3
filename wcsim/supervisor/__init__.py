"""The paper's supervisor and the oracle: actions, observation, rewards, KPIs; pure functions over `types`.

Not the user.
"""
