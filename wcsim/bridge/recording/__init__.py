"""A world's state as a record and a hash, and logs for other programs: SUMO's floating car data, ROS 2 bags."""
