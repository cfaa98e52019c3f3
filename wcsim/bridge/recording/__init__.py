"""Logs as files for other programs: SUMO's floating car data, ROS 2 bags."""
