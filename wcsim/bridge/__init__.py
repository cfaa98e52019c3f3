"""One world: SUMO and PyBullet in step. Read `world.py` first."""
