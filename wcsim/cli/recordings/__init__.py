"""Commands for recordings: replay, and the users that are recorded and fitted. Not the results of tests."""
