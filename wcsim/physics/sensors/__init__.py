"""Sensors of a chair: cameras and IMU, with their noise. A new sensor is a file here."""
