"""Sensors of a chair: cameras, IMU, odometry, with their noise. A new sensor is a file here."""
