"""Towns without a map: streets by SUMO's netgenerate, things and traffic, from one seed."""
