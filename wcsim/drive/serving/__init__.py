"""Serves browsers: page files, a socket per page, access control. `drive/runner.py` drives."""
