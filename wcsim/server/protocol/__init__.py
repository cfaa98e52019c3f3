"""The protocol without sockets: messages, the barrier, both cores, admission. Model-checked; no clock, no file."""
