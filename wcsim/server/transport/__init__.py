"""How messages and pictures travel: ZeroMQ sockets, keys, rate limits, shared memory."""
