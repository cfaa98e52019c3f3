"""How the cost of a tick grows with wheelchairs, actors and the size of the town; not what one tick costs."""
