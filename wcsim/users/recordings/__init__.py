"""Recordings of people: users that replay a stick, and profiles fitted to one."""
