"""The law of `wcsim.core.joystick` with tensors, for networks that are exported; a test holds the two together."""

from __future__ import annotations

import torch

from wcsim.core.joystick import (
    ACCEL,
    DECEL,
    JERK,
    REVERSE,
    STILL_MPS,
    V_MAX,
    YAW_ACCEL,
    YAW_MAX,
    YAW_SLOWDOWN_S_PER_M,
)
from wcsim.types import F64


class Drive:
    """How a chair obeys its stick.

    Args:
        limits: (7,) of the drive, see `limits_of`.
        deadband: Of the joystick.
        exponent: Of its shape.
    """

    def __init__(self, limits: F64, deadband: float, exponent: float) -> None:
        self._limits: list[float] = limits.tolist()
        self._deadband, self._exponent = deadband, exponent

    def shaped(self, stick: torch.Tensor) -> torch.Tensor:
        """Joystick positions (B, 2) as the drive takes them."""
        radius = (stick * stick).sum(dim=1, keepdim=True).sqrt()
        out = ((radius.clamp(max=1.0) - self._deadband) / (1.0 - self._deadband)).clamp(min=0.0) ** self._exponent
        return stick / radius.clamp(min=1e-9) * out

    def follow(self, motion: torch.Tensor, command: torch.Tensor, dt_s: float) -> torch.Tensor:
        """Speed, turn rate and acceleration (B, 3) `dt_s` later, with shaped commands (B, 2)."""
        limits = self._limits
        v, w, a = motion[:, 0], motion[:, 1], motion[:, 2]
        x, y = command[:, 0], command[:, 1]
        v_wanted = y * limits[V_MAX] * torch.where(y < 0.0, limits[REVERSE], 1.0)
        fastest = torch.maximum(v_wanted.abs(), v.abs())
        w_wanted = -x * limits[YAW_MAX] / (1.0 + YAW_SLOWDOWN_S_PER_M * fastest)
        jerk = limits[JERK]
        gap = v_wanted - v
        limit = torch.where(v * gap < 0.0, limits[DECEL], limits[ACCEL])
        ahead = gap - a * dt_s
        a_wanted = torch.sign(ahead) * torch.minimum(limit, (2.0 * jerk * ahead.abs()).sqrt())
        a = a + (a_wanted - a).clamp(-jerk * dt_s, jerk * dt_s)
        move = a * dt_s
        there = (gap.abs() <= move.abs() + STILL_MPS * dt_s) & (a.abs() <= 2.0 * jerk * dt_s + 0.1)
        most = limits[YAW_ACCEL] * dt_s
        turn = w + (w_wanted - w).clamp(-most, most)
        v, a = torch.where(there, v_wanted, v + move), torch.where(there, torch.zeros_like(a), a)
        return torch.stack([v, turn, a], 1)

    def advance(self, state: torch.Tensor, command: torch.Tensor, dt_s: float) -> torch.Tensor:
        """States (B, 6) x, y, yaw, v, w, acceleration `dt_s` later."""
        now = self.follow(state[:, 3:], command, dt_s)
        turn = 0.5 * (state[:, 4] + now[:, 1]) * dt_s
        way = 0.5 * (state[:, 3] + now[:, 0]) * dt_s
        heading = state[:, 2] + 0.5 * turn
        x, y = state[:, 0] + way * torch.cos(heading), state[:, 1] + way * torch.sin(heading)
        return torch.cat([torch.stack([x, y, state[:, 2] + turn], 1), now], 1)
