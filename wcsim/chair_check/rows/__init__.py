"""The rows of the chair's table: each a trial with what is expected of it."""
