"""Towns without a map: streets by SUMO's netgenerate, and all that stands and drives in them, from one seed."""
