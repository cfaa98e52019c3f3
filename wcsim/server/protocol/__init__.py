"""The protocol without sockets: messages, barrier, both cores. Model-checked; no clock, no file."""
