"""PyBullet, loaded without the line about its build time; everybody takes it from here."""

from __future__ import annotations

from wcsim.core.native_output import without_line

__all__ = ["pybullet"]

with without_line(b"pybullet build time:"):
    import pybullet
