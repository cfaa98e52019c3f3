"""PyBullet and everything a chair feels or sees. Only here PyBullet is spoken to. No SUMO."""
