"""What is judged of a chair (by oracle, rule and network), held against what the physics does."""
