"""Serves browsers: the page's files, a socket per page, access control. `drive/runner` drives."""
