"""One tick of a policy as a torch module for export: what it remembers goes in and comes out, pictures go in once.

`DangerGraph` makes the street map as `danger/street_map.py` does, with the tensors that ONNX knows; a test holds the
two together (`tests/agents/export/test_danger_graph.py`).
Each operation costs a machine more than the numbers in it, so there are as few as can be.
`ValueGraph` has the state of a network that carries one, else the earlier pictures of its window.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import torch
from torch import nn

from wcsim.agents.danger.network import DangerNet
from wcsim.agents.danger.policy import GIVES_BACK, LESS_M, RECENT_TICKS
from wcsim.agents.danger.street_map import (
    BEHIND_M,
    CELL_M,
    COMMANDS,
    EACH_SLICE,
    FULL_MOTION,
    HALF_M,
    HEAD_M,
    HOLD_S,
    KEEP_TICKS,
    LOW_M,
    MOVER_M,
    PLANES,
    RASTER,
    REACH_M,
    SIDE,
    SLICES,
    SPAN_M,
    STEP_S,
    TILT,
    TRAIL_TICKS,
    TURNS,
    hull_and_wheels,
    kinds_of_ground,
    movers,
)
from wcsim.agents.networks.encoder import image_size
from wcsim.agents.networks.q_network import QNet
from wcsim.agents.perception.alarm import CALM, NEWEST
from wcsim.agents.perception.depth_image import viewing_rays
from wcsim.agents.perception.ego_motion import (
    GYRO_Z,
    MOVES_MPS,
    SPEED_FULL_SCALE,
    TRUST,
    TURN_FULL_SCALE,
)
from wcsim.agents.perception.surroundings import box_of, stride_px
from wcsim.agents.policy_api import CLASS_KEY, DEPTH_KEY
from wcsim.config import RunConfig
from wcsim.config.run_file import DangerRule
from wcsim.core.joystick import (
    ACCEL,
    DECEL,
    JERK,
    REVERSE,
    STILL_MPS,
    V_MAX,
    YAW_ACCEL,
    YAW_MAX,
    YAW_SLOWDOWN,
    limits_of,
    shaped_rows,
)
from wcsim.errors import PolicyError
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.supervisor.actions import MAX_DISTANCE, action_set
from wcsim.supervisor.observation import decode_depth
from wcsim.types import F64

Motion = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
"""Speed, turn rate and acceleration, (B,) each."""

Places = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
"""x, y and yaw; (B,) each, or (T, B) of successive steps."""


class Drive:
    """How a chair obeys its stick.

    Args:
        limits: (8,) of the drive, see `limits_of`.
        deadband: Of the joystick.
        exponent: Of its shape.
    """

    def __init__(self, limits: F64, deadband: float, exponent: float) -> None:
        self._limits: list[float] = limits.tolist()
        self._deadband, self._exponent = deadband, exponent

    def shaped(self, stick: torch.Tensor) -> torch.Tensor:
        """Joystick positions (B, 2) as the drive takes them."""
        radius = (stick * stick).sum(dim=1, keepdim=True).sqrt()
        out = ((radius.clamp(max=1.0) - self._deadband) / (1.0 - self._deadband)).clamp(
            min=0.0
        ) ** self._exponent
        return stick / radius.clamp(min=1e-9) * out

    def wanted(self, command: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """The speed (B,) that shaped commands (B, 2) ask for, and the turn rate as it were on the spot."""
        limits = self._limits
        x, y = command[:, 0], command[:, 1]
        return y * limits[V_MAX] * torch.where(y < 0.0, limits[REVERSE], 1.0), -x * limits[YAW_MAX]

    def follow(
        self, motion: Motion, wanted: tuple[torch.Tensor, torch.Tensor], dt_s: float
    ) -> Motion:
        """The motion `dt_s` later, with what `wanted` gives."""
        v, w, a = motion
        faster, a = self._faster(v, a, wanted[0] - v, dt_s)
        return faster, self._turned(w, self._turn(wanted, v), dt_s), a

    def roll(
        self, places: Places, motion: Motion, command: torch.Tensor, holds: list[bool], dt_s: float
    ) -> Places:
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
        return wanted[1] / (
            1.0 + self._limits[YAW_SLOWDOWN] * torch.maximum(wanted[0].abs(), v.abs())
        )

    def _turned(self, w: torch.Tensor, asked: torch.Tensor, dt_s: float) -> torch.Tensor:
        most = self._limits[YAW_ACCEL] * dt_s
        return w + (asked - w).clamp(-most, most)

    def advance(
        self, places: Places, motion: Motion, command: torch.Tensor, dt_s: float
    ) -> tuple[Places, Motion]:
        """Places and motion (B,) `dt_s` later, with shaped commands (B, 2)."""
        now = self.follow(motion, self.wanted(command), dt_s)
        turn, way = 0.5 * dt_s * (motion[1] + now[1]), 0.5 * dt_s * (motion[0] + now[0])
        heading = places[2] + 0.5 * turn
        x, y = places[0] + way * torch.cos(heading), places[1] + way * torch.sin(heading)
        return (x, y, places[2] + turn), now


_KEY, _TICK, _MOVER, _CLASS, _HIGH, _LOW = range(6)
_KEYS: Final = (
    4096.0  # cells each way, after which keys come again: 410 m away, and float32 holds all of them
)
_NOWHERE: Final = -1.0e6


class DangerGraph(nn.Module):
    """One step of a danger policy; every state is zero at the start of an episode.

    Args:
        net: One that looks at the street map.
        config: Of the run.
        rule: From dangers to an action.
    """

    inputs: Final = ("depth", "seg", "imu", "odometry", "joystick")
    outputs: Final = ("values", "warning", "danger")
    checked: Final = "danger"  # the output that is compared with the network's own
    border_share: Final = (
        0.02  # of the steps, in which a place on the border of two cells may be read in the other
    )
    window: Final = 1  # images that it looks at

    def __init__(self, net: DangerNet, config: RunConfig, rule: DangerRule) -> None:
        """Raises PolicyError for a network that cannot be exported."""
        super().__init__()
        if net.spec.pictures:
            raise PolicyError(
                f"a network with danger.eye={net.spec.net.eye} cannot be exported; "
                "train with danger.eye=map, its default"
            )
        camera, actions = config.cameras[0], action_set(config.env.actions)
        self.net, self.rule, self.delay = net, rule, config.world.action_delay_ticks
        self.tick_s, self.far_m = config.world.tick_s, 0.99 * camera.range_m
        self.stride = stride_px(camera)
        rays = viewing_rays(camera).reshape(camera.height_px, camera.width_px, 3)[
            :: self.stride, :: self.stride
        ]
        spec = plant_spec(config.chair)
        self.drive = Drive(
            limits_of(config.chair), config.chair.deadband, config.chair.shape_exponent
        )
        chair = hull_and_wheels(box_of(spec.outline), np.array(spec.stand_m(), np.float64))
        self.rays, self.eye = _constant(rays.reshape(-1, 3)), _constant(np.array(camera.p_BC_m))
        self.metres = _constant(decode_depth(np.arange(256, dtype=np.uint8), camera.range_m))
        self.kinds, self.movers = _constant(kinds_of_ground()), _constant(movers())
        self.points, self.commands = (
            _constant(actions.points),
            _constant(shaped_rows(actions.points, config.chair)),
        )
        self.chair, self.plane, self.cells_B = (
            _constant(chair),
            _constant(_planes(chair)),
            _constant(_cells_B()),
        )

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The shapes of all states."""
        return {
            "state_motion": (1, 8),  # begun, tick, x, y, yaw in O, v, w, acceleration
            "state_waiting": (
                1,
                self.delay + 1,
                2,
            ),  # sent, not yet measured; the oldest was obeyed last
            "state_sent": (1, COMMANDS, 2),
            "state_last": (1, 1),  # action, counted from 1
            "state_cells": (1, 6, RASTER * RASTER),
            "state_alarm": (1, 2),  # smoothed danger of the user's own stick, and whether it warns
            "state_recent": (
                1,
                1,
            ),  # ticks left in which the user's own action was unsafe a short time ago
        }

    def forward(
        self,
        depth: torch.Tensor,
        seg: torch.Tensor,
        imu: torch.Tensor,
        odometry: torch.Tensor,
        joystick: torch.Tensor,
        *states: torch.Tensor,
    ) -> tuple[torch.Tensor, ...]:
        """Values (1, A), warning (1, 1), dangers (1, A), and the next states."""
        motion, waiting, sent, last, cells, alarm, recent = states
        asked = self.drive.shaped(joystick)
        motion, waiting = self._moved(imu, odometry, asked, motion, waiting)
        cells = self._seen(depth, seg, motion, cells)
        codes = self._codes(motion, cells)
        places, start = self._start(motion, waiting)
        holds = [step * STEP_S < HOLD_S - 1e-9 for step in range(SLICES * EACH_SLICE)]
        rolled = self.drive.roll(places, start, self.commands, holds, STEP_S)
        vector = self._vector(imu, motion, sent)
        danger = torch.sigmoid(self.net(codes[None] / 255.0, vector, self._swept(rolled)))
        values, recent = self._values(danger, joystick, last, recent)
        action = values.argmax(dim=1)
        alarm = self._alarm(danger, joystick, alarm)
        chosen = self.commands[action][:, None]
        waiting = torch.cat([waiting[:, 1:], chosen], 1)
        sent = torch.cat([self.points[action][:, None], sent[:, :-1]], 1)
        last = (action[:, None] + 1).to(torch.float32)
        return values, alarm[:, 1:2], danger, motion, waiting, sent, last, cells, alarm, recent

    def _alarm(
        self, danger: torch.Tensor, joystick: torch.Tensor, alarm: torch.Tensor
    ) -> torch.Tensor:
        """As `alarm.next_alarm`."""
        wish = ((self.points[None] - joystick[:, None]) ** 2).sum(-1).argmin(dim=1)
        level = alarm[:, 0:1] + NEWEST * (danger.gather(1, wish[:, None]) - alarm[:, 0:1])
        kept = (alarm[:, 1:2] > 0.5) & (level > CALM * self.rule.warn)
        return torch.cat([level, ((level > self.rule.warn) | kept).to(level.dtype)], 1)

    def _moved(
        self,
        imu: torch.Tensor,
        odometry: torch.Tensor,
        asked: torch.Tensor,
        motion: torch.Tensor,
        waiting: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """As `EgoMotion.observe`."""
        begun = motion[:, 0:1] > 0.5
        measured = torch.cat(
            [odometry[:, 0:1] * SPEED_FULL_SCALE, imu[:, GYRO_Z : GYRO_Z + 1] * TURN_FULL_SCALE], 1
        )
        v, w, a = (motion[:, part] for part in (5, 6, 7))
        after = self.drive.follow((v, w, a), self.drive.wanted(waiting[:, 0]), self.tick_s)
        mean = 0.5 * torch.stack([v + after[0], w + after[1]], 1)
        now = torch.cat(
            [torch.stack(after[:2], 1) + TRUST * (measured - mean), after[2][:, None]], 1
        )
        way, turn = measured[:, 0:1] * self.tick_s, measured[:, 1:2] * self.tick_s
        heading = motion[:, 4:5] + 0.5 * turn
        pose = motion[:, 2:5] + torch.cat(
            [way * torch.cos(heading), way * torch.sin(heading), turn], 1
        )
        fresh = torch.cat([measured, torch.zeros_like(measured[:, :1])], 1)
        moves = (measured[:, 0:1].abs() > MOVES_MPS).to(measured.dtype)
        first = (asked * moves)[:, None].expand_as(waiting)
        state = torch.cat([torch.ones_like(way), motion[:, 1:2] + 1.0, pose, now], 1)
        begins = torch.cat(
            [torch.ones_like(way), torch.ones_like(way), torch.zeros_like(pose), fresh], 1
        )
        return torch.where(begun, state, begins), torch.where(begun[:, None], waiting, first)

    def _seen(
        self, depth: torch.Tensor, seg: torch.Tensor, motion: torch.Tensor, cells: torch.Tensor
    ) -> torch.Tensor:
        """As `StreetMap.see`."""
        tick = motion[:, 1:2]
        metres = self.metres[self._looked_at(depth)]
        place = self.eye + metres[:, None] * self.rays
        classes = self._looked_at(seg)
        kind, may_move = self.kinds[classes], self.movers[classes]
        used = (metres > 0.0) & (metres < self.far_m) & (place[:, 2] <= HEAD_M)
        used = used & (place[:, :2].abs().amax(dim=1) <= REACH_M)
        x, y = _in_O(motion, place[:, 0], place[:, 1])
        ix, iy = torch.floor(x / CELL_M), torch.floor(y / CELL_M)
        cells_and_none = (
            RASTER * RASTER + 1
        )  # what is not used goes into a cell more, which is let go of
        slot = torch.where(used, _slot(ix, iy), torch.full_like(ix, RASTER * RASTER)).to(
            torch.int64
        )
        order = torch.arange(len(kind), dtype=kind.dtype, device=kind.device)
        kinds = torch.where(
            kind > 0, 8.0 * order + kind, torch.zeros_like(kind)
        )  # the last one of a cell wins
        moving = may_move * (place[:, 2] > MOVER_M).to(kind.dtype)
        said = torch.stack([_key(ix, iy), moving, kinds, place[:, 2], -place[:, 2]])
        begin = said.new_full(
            (5 * cells_and_none,), _NOWHERE
        )  # one after the other: ONNX takes no more dimensions
        slots = torch.cat([slot + number * cells_and_none for number in range(5)])
        most = begin.scatter_reduce(
            0, slots, said.reshape(-1), reduce="amax", include_self=True
        ).view(5, -1)[:, :-1]
        key, moving, kinds, high, low = (most[number] for number in range(5))
        old = cells[0]
        seen = high > 0.5 * _NOWHERE
        same = (old[_KEY] == key) & (old[_TICK] > 0.0)
        now = tick[0].expand_as(high)
        mover = torch.where(
            moving > 0.5, now, torch.where(same, old[_MOVER], torch.zeros_like(high))
        )
        kinds = kinds - 8.0 * torch.floor(kinds / 8.0)
        return torch.where(seen, torch.stack([key, now, mover, kinds, high, -low]), old)[None]

    def _looked_at(self, image: torch.Tensor) -> torch.Tensor:
        """As `StreetSense`: (n,) int64, one for each of `rays`."""
        return image[..., :: self.stride, :: self.stride].reshape(-1).to(torch.int64)

    def _codes(self, motion: torch.Tensor, cells: torch.Tensor) -> torch.Tensor:
        """As `StreetMap.picture`, (PLANES, SIDE, SIDE) in 0..255."""
        x, y = _in_O(motion, self.cells_B[:, 0], self.cells_B[:, 1])
        ix, iy = torch.floor(x / CELL_M), torch.floor(y / CELL_M)
        found = cells[0].index_select(1, _slot(ix, iy).to(torch.int64))
        known = (found[_TICK] > 0.0) & (found[_KEY] == _key(ix, iy))
        tick = motion[0, 1]
        age, trail = tick - found[_TICK], tick - found[_MOVER]
        fresh = (known & (age <= KEEP_TICKS)).to(x.dtype)
        moved = (known & (found[_MOVER] > 0.0) & (trail <= TRAIL_TICKS)).to(x.dtype)
        planes = torch.stack(
            [
                fresh * _height_code(found[_HIGH]),
                fresh * _height_code(found[_LOW]),
                fresh * (255.0 - 5.0 * age),
                moved * (255.0 - 12.0 * trail),
                fresh * 60.0 * found[_CLASS],
            ]
        )
        return planes.reshape(PLANES, SIDE, SIDE)

    def _start(self, motion: torch.Tensor, waiting: torch.Tensor) -> tuple[Places, Motion]:
        """As `StreetSense.start`: (1,) each."""
        here = torch.zeros_like(motion[:, 0])
        places, now = (here, here, here), (motion[:, 5], motion[:, 6], motion[:, 7])
        for number in range(self.delay):
            places, now = self.drive.advance(places, now, waiting[:, number + 1], self.tick_s)
        return places, now

    def _vector(self, imu: torch.Tensor, motion: torch.Tensor, sent: torch.Tensor) -> torch.Tensor:
        """As `FeatureExtractor` has it."""
        scaled = motion[:, 5:8] / motion.new_tensor(FULL_MOTION)
        later = motion.new_full((1, 1), self.delay * self.tick_s)
        said = torch.cat(
            [10.0 * imu[:, TILT], imu[:, TURNS], scaled, later, sent.reshape(1, -1)], 1
        )
        return said.clamp(-2.0, 2.0)

    def _swept(self, rolled: Places) -> torch.Tensor:
        """As `street_map.sweep`: (1, A, n) int64."""
        x, y, yaw = (part[:, :, None] for part in rolled)
        cos, sin = torch.cos(yaw), torch.sin(yaw)
        x = x + cos * self.chair[:, 0] - sin * self.chair[:, 1]
        y = y + sin * self.chair[:, 0] + cos * self.chair[:, 1]
        row = (SIDE - 1 - torch.floor((x + BEHIND_M) / CELL_M)).clamp(0, SIDE - 1)
        column = torch.floor((HALF_M - y) / CELL_M).clamp(0, SIDE - 1)
        found = self.plane + row * SIDE + column
        return found.transpose(0, 1).reshape(1, len(self.commands), -1).to(torch.int64)

    def _values(
        self, danger: torch.Tensor, joystick: torch.Tensor, last: torch.Tensor, recent: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """The highest one is what `danger.policy` takes, and `_next_recent` of it."""
        rule = self.rule
        distance = (
            ((self.points[None] - joystick[:, None]) ** 2).sum(-1).sqrt().clamp(max=MAX_DISTANCE)
        )
        numbers = torch.arange(1, len(self.points) + 1, dtype=danger.dtype, device=danger.device)[
            None
        ]
        kept = (numbers == last).to(danger.dtype)
        cost = distance + rule.danger_cost * danger / rule.threshold - rule.hysteresis * kept
        own = numbers == distance.argmin(dim=1, keepdim=True) + 1
        taken = ((recent > 1.5) & own & (numbers != last)).to(danger.dtype)
        limit = (
            rule.threshold
            * (1.0 + (rule.hysteresis_factor - 1.0) * kept)
            * (1.0 - (1.0 - GIVES_BACK) * taken)
        )
        cost = torch.where(own, torch.full_like(cost, -1e6), cost)
        allowed = danger < limit
        doubtful = (recent < 0.5) & (danger < rule.at_once)
        unsafe = (own & ~allowed).any(dim=1, keepdim=True)
        sure = (own & ~doubtful).any(dim=1, keepdim=True).to(recent.dtype)
        later = torch.where(
            unsafe, 1.0 + (RECENT_TICKS - 1.0) * sure, (recent - 1.0).clamp(min=0.0)
        )
        allowed = allowed | (own & doubtful)
        nothing = ~allowed.any(dim=1, keepdim=True)
        cost = torch.where(allowed, cost, torch.full_like(cost, 1e6))
        return -torch.where(nothing, danger + LESS_M * distance, cost), later


def _constant(numbers: np.ndarray) -> torch.Tensor:
    """What a graph never changes, float32; no file of weights holds it."""
    return nn.Buffer(torch.from_numpy(np.ascontiguousarray(numbers, np.float32)), persistent=False)


def _in_O(
    motion: torch.Tensor, x: torch.Tensor, y: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    cos, sin = torch.cos(motion[0, 4]), torch.sin(motion[0, 4])
    return motion[0, 2] + cos * x - sin * y, motion[0, 3] + sin * x + cos * y


def _slot(ix: torch.Tensor, iy: torch.Tensor) -> torch.Tensor:
    return _number(ix, iy, RASTER)


def _key(ix: torch.Tensor, iy: torch.Tensor) -> torch.Tensor:
    return _number(ix, iy, _KEYS)


def _number(ix: torch.Tensor, iy: torch.Tensor, side: float) -> torch.Tensor:
    """Of a cell, row by row, in a square of so many each way that comes again and again."""
    return (ix - side * torch.floor(ix / side)) * side + (iy - side * torch.floor(iy / side))


def _height_code(height_m: torch.Tensor) -> torch.Tensor:
    return 1.0 + torch.floor(254.0 * ((height_m - LOW_M) / SPAN_M).clamp(0.0, 1.0))


def _planes(chair: np.ndarray) -> np.ndarray:
    """(steps, 1, n) where in flat cost maps those of each point of the chair begin."""
    each_slice = np.repeat(np.arange(SLICES), EACH_SLICE)[:, None, None]
    return SIDE * SIDE * (each_slice + SLICES * (chair[:, 2] > 0.0))


def _cells_B() -> np.ndarray:
    """(SIDE * SIDE, 2) middles of the picture's cells in B."""
    rows, columns = np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij")
    x = (SIDE - rows - 0.5) * CELL_M - BEHIND_M
    y = HALF_M - (columns + 0.5) * CELL_M
    return np.stack([x.reshape(-1), y.reshape(-1)], 1)


class ValueGraph(nn.Module):
    """One tick of a network of Q-learning; every state is zero at the start of an episode.

    Args:
        net: Its weights.
        window: Images that it looks at; 1 if it carries a state.
    """

    outputs: Final = ("values",)
    checked: Final = "values"
    border_share: Final = 0.0

    def __init__(self, net: QNet, window: int) -> None:
        """Raises PolicyError for a network that sees something else than classes and depth."""
        if net.encoder.form != "compact":
            raise PolicyError(
                f"a network that sees env.observation={net.encoder.form} cannot be exported; expected compact"
            )
        super().__init__()
        self.net, self.window = net, window
        self.inputs = (DEPTH_KEY, CLASS_KEY, *net.encoder.vector_keys)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The shapes of all states."""
        if self.net.spec.stateful:
            return {"state_memory": (1, self.net.encoder.state_size)}
        height_px, width_px = image_size(self.net.observation_space)
        earlier = (
            1,
            2,
            self.window - 1,
            height_px,
            width_px,
        )  # depth and classes, each number one higher
        return {"state_pictures": earlier} if self.window > 1 else {}

    def forward(self, *given: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Values (1, A) and the next states, of inputs and states in the order of `inputs` and `shapes`."""
        seen, states = dict(zip(self.inputs, given, strict=False)), given[len(self.inputs) :]
        if self.net.spec.stateful:
            return self.net.step(seen, *states)
        if not states:
            return (self.net(seen),)
        (earlier,) = states
        newest = torch.stack([seen[DEPTH_KEY], seen[CLASS_KEY]], 1).to(torch.float32) + 1.0
        # 0 is no picture yet: the first one of an episode fills the window, as in `FrameWindow`
        pictures = torch.cat([torch.where(earlier > 0.0, earlier, newest), newest], 2)
        depth, classes = (pictures - 1.0).unbind(1)
        return self.net({**seen, DEPTH_KEY: depth, CLASS_KEY: classes}), pictures[:, :, 1:]
