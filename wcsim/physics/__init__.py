"""PyBullet behind `engine.py`: the wheelchair, its drive and IMU, mirror bodies, cameras."""
