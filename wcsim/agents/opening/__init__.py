"""Whatever a user names, opened: policies of any kind, lists of test episodes, the street of a block."""
