"""What films are made of: journals, traces, drives, episodes of suites, runs. Each in a process of its own."""
