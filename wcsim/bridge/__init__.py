"""One world: SUMO and PyBullet in step. Read `world.py` first. No sockets, no networks."""
