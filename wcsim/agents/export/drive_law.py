"""The law of `wcsim.core.joystick` with tensors, for networks that are exported; a test holds the two together.

A machine without wcsim pays for each operation, not for the numbers in it: what need not go step by step is done for
all steps at once.
"""

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

Motion = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
"""Speed, turn rate and acceleration, (B,) each."""

Places = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
"""x, y and yaw; (B,) each, or (T, B) of successive steps."""


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

    def wanted(self, command: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The speed (B,) that shaped commands (B, 2) ask for, and the turn rate as it were on the spot."""
        limits = self._limits
        x, y = command[:, 0], command[:, 1]
        return y * limits[V_MAX] * torch.where(y < 0.0, limits[REVERSE], 1.0), -x * limits[YAW_MAX]

    def follow(self, motion: Motion, wanted: tuple[torch.Tensor, torch.Tensor], dt_s: float) -> Motion:
        """The motion `dt_s` later, with what `wanted` gives."""
        v, w, a = motion
        faster, a = self._faster(v, a, wanted[0] - v, dt_s)
        return faster, self._turned(w, self._turn(wanted, v), dt_s), a

    def roll(self, places: Places, motion: Motion, command: torch.Tensor, holds: list[bool], dt_s: float) -> Places:
        """Where shaped commands (B, 2) bring chairs that begin at `places` with `motion`, (T, B) after each step.

        Args:
            places: (1,) each, or (B,).
            motion: (1,) each, or (B,).
            command: Held where `holds` says so, let go elsewhere.
            holds: Of each of the T steps.
            dt_s: Of a step.
        """
        wanted = self.wanted(command)
        v, w, a = (part.expand(1, len(command)) for part in motion)
        speeds = [v]
        for held in holds:  # rows (1, B), so that nothing has to be made one row afterwards
            v, a = self._faster(v, a, wanted[0] - v if held else -v, dt_s)
            speeds.append(v)
        all_v = torch.cat(speeds)
        held_now = torch.tensor(holds, device=command.device)[:, None]
        turns = [w]
        for turn in torch.split(torch.where(held_now, self._turn(wanted, all_v[:-1]), 0.0), 1):
            turns.append(self._turned(turns[-1], turn, dt_s))
        all_w = torch.cat(turns)
        way, turned = 0.5 * dt_s * (all_v[:-1] + all_v[1:]), 0.5 * dt_s * (all_w[:-1] + all_w[1:])
        yaw = places[2] + turned.cumsum(0)
        heading = yaw - 0.5 * turned
        x, y = (way * torch.cos(heading)).cumsum(0), (way * torch.sin(heading)).cumsum(0)
        return places[0] + x, places[1] + y, yaw

    def _faster(
        self, v: torch.Tensor, a: torch.Tensor, gap: torch.Tensor, dt_s: float
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Speed and acceleration `dt_s` later, where `gap` is missing."""
        limits, jerk = self._limits, self._limits[JERK]
        limit = torch.where(v * gap < 0.0, limits[DECEL], limits[ACCEL])
        ahead = gap - a * dt_s
        a_wanted = torch.sign(ahead) * torch.minimum(limit, (ahead.abs() * (2.0 * jerk)).sqrt())
        a = a + (a_wanted - a).clamp(-jerk * dt_s, jerk * dt_s)
        move = a * dt_s
        there = (gap.abs() <= move.abs() + STILL_MPS * dt_s) & (a.abs() <= 2.0 * jerk * dt_s + 0.1)
        return v + torch.where(there, gap, move), torch.where(there, 0.0, a)

    def _turn(self, wanted: tuple[torch.Tensor, torch.Tensor], v: torch.Tensor) -> torch.Tensor:
        """The turn rate that is asked for at a speed."""
        return wanted[1] / (1.0 + YAW_SLOWDOWN_S_PER_M * torch.maximum(wanted[0].abs(), v.abs()))

    def _turned(self, w: torch.Tensor, asked: torch.Tensor, dt_s: float) -> torch.Tensor:
        most = self._limits[YAW_ACCEL] * dt_s
        return w + (asked - w).clamp(-most, most)

    def advance(self, places: Places, motion: Motion, command: torch.Tensor, dt_s: float) -> tuple[Places, Motion]:
        """Places and motion (B,) `dt_s` later, with shaped commands (B, 2)."""
        now = self.follow(motion, self.wanted(command), dt_s)
        turn, way = 0.5 * dt_s * (motion[1] + now[1]), 0.5 * dt_s * (motion[0] + now[0])
        heading = places[2] + 0.5 * turn
        x, y = places[0] + way * torch.cos(heading), places[1] + way * torch.sin(heading)
        return (x, y, places[2] + turn), now
