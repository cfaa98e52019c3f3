"""How a client reaches a world: in this process, in a child, over a socket; and a fake world for tests."""
