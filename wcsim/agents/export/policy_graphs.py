"""One tick of a policy as a torch module for the export to ONNX: its memory goes in and comes out.

A danger policy drives with NumPy and numba kernels, which no exporter can trace. `TorchDriveModel`
and `DangerPolicyGraph` therefore compute the same a second time, with the tensor operations that
ONNX has. Each of their methods names the function it repeats: a change of one is a change of both.
`tests/agents/export/test_danger_graph.py` compares them. An operation costs more than the numbers
in it, so there are as few as possible. `ValuePolicyGraph` calls the network itself, and repeats
when `_NetPolicy` warns.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn

from wcsim.agents.danger import street_map
from wcsim.agents.danger.network import DangerNet
from wcsim.agents.danger.policy import (
    DANGER_PER_DISTANCE,
    GIVES_BACK,
    RECENT_TICKS,
    takes_away_at,
)
from wcsim.agents.networks.encoder import image_size_from_space
from wcsim.agents.networks.q_network import QNet
from wcsim.agents.perception.alarm import CALM, NEWEST, TWO_TICKS
from wcsim.agents.perception.depth_image import FAR_SHARE, sampling_stride_px, viewing_rays
from wcsim.agents.perception.ego_motion import (
    GYRO_Z,
    MOVES_MPS,
    SPEED_FULL_SCALE,
    TRUST,
    TURN_FULL_SCALE,
)
from wcsim.agents.perception.surroundings import outline_to_box
from wcsim.agents.policy_api import (
    CLASS_KEY,
    DEPTH_KEY,
    IMU_KEY,
    JOYSTICK_KEY,
    ODOMETRY_KEY,
)
from wcsim.config import RunConfig
from wcsim.config.run_file import DangerRuleSettings
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
    drive_limits_from_chair,
    shape_joysticks,
)
from wcsim.errors import PolicyError
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.supervisor.actions import MAX_DISTANCE, action_set
from wcsim.supervisor.observation import decode_depth
from wcsim.types import F64

# Columns of the state of motion: whether the episode has started, its tick, pose in O, then
# speed, turn rate and acceleration.
_STARTED: Final = slice(0, 1)
_NOW: Final = slice(1, 2)
_POSE: Final = slice(2, 5)
_MOTION: Final = slice(5, 8)
# Rows of the state of cells.
_KEY, _TICK, _MOVER, _CLASS, _HIGH, _LOW = range(6)
# A key wraps around after so many cells each way, 410 m; float32 holds all keys exactly.
_KEY_SIDE: Final = 4096.0
_EMPTY: Final = -1.0e6  # below any value of a cell

Pair = tuple[Tensor, Tensor]
Motion = tuple[Tensor, Tensor, Tensor]
"""Speed, turn rate and acceleration, (B,) each."""

Places = tuple[Tensor, Tensor, Tensor]
"""x, y and yaw; (B,) each, or (T, B) of successive steps."""


class TorchDriveModel:
    """How a chair obeys its stick: `core/joystick.py` in tensors, for many commands at once.

    The numba kernels there take single floats and branch, which a traced graph cannot.

    Args:
        limits: (8,) of the drive, see `drive_limits_from_chair`.
        deadband: Of the joystick.
        exponent: Of its shape.
    """

    def __init__(self, limits: F64, deadband: float, exponent: float) -> None:
        self._limits: list[float] = limits.tolist()
        self._deadband, self._exponent = deadband, exponent

    def shaped(self, stick: Tensor) -> Tensor:
        """Joystick positions (B, 2) as the drive takes them; repeats `joystick.shape_joysticks`."""
        radius = (stick * stick).sum(dim=1, keepdim=True).sqrt()
        pushed = (radius.clamp(max=1.0) - self._deadband) / (1.0 - self._deadband)
        out = pushed.clamp(min=0.0) ** self._exponent
        return stick / radius.clamp(min=1e-9) * out

    def targets(self, command: Tensor) -> Pair:
        """The speed (B,) that shaped commands (B, 2) demand, and the turn rate if on the spot.

        The part of the drive's law that does not depend on its speed of now, so that `roll_out`
        needs it once for all steps. `_target_turn` is the rest.
        """
        limits = self._limits
        x, y = command[:, 0], command[:, 1]
        return y * limits[V_MAX] * torch.where(y < 0.0, limits[REVERSE], 1.0), -x * limits[YAW_MAX]

    def follow(self, motion: Motion, targets: Pair, dt_s: float) -> Motion:
        """The motion `dt_s` later, with what `targets` gives; repeats `joystick.advance_drive`."""
        v, w, a = motion
        later, a = self._follow_speed(v, a, targets[0] - v, dt_s)
        return later, self._follow_turn(w, self._target_turn(targets, v), dt_s), a

    def advance(
        self, places: Places, motion: Motion, command: Tensor, dt_s: float
    ) -> tuple[Places, Motion]:
        """Places and motion (B,) `dt_s` later; repeats `arcs.integrate_chair_state`.

        Commands are (B, 2).
        """
        now = self.follow(motion, self.targets(command), dt_s)
        turn, way = 0.5 * dt_s * (motion[1] + now[1]), 0.5 * dt_s * (motion[0] + now[0])
        heading = places[2] + 0.5 * turn
        x, y = places[0] + way * torch.cos(heading), places[1] + way * torch.sin(heading)
        return (x, y, places[2] + turn), now

    def roll_out(
        self, places: Places, motion: Motion, command: Tensor, holds: list[bool], dt_s: float
    ) -> Places:
        """Where shaped commands (B, 2) bring chairs, (T, B) after each step.

        Repeats the loop over `arcs.integrate_chair_state` in `street_map.sweep`. Here speeds, turn
        rates and places are computed one after the other, each for all steps: a graph of fewer
        operations.

        Args:
            places: At the start, (1,) each, or (B,).
            motion: At the start, (1,) each, or (B,).
            command: Held where `holds` is true; elsewhere the stick is released.
            holds: Of each of the T steps.
            dt_s: Of a step.
        """
        targets = self.targets(command)
        # Rows (1, B), so that nothing has to be reshaped into one afterwards.
        v, w, a = (part.expand(1, len(command)) for part in motion)
        speeds = [v]
        for held in holds:
            v, a = self._follow_speed(v, a, targets[0] - v if held else -v, dt_s)
            speeds.append(v)
        all_v = torch.cat(speeds)
        held_now = torch.tensor(holds, device=command.device)[:, None]
        turns = [w]
        target_turns = torch.where(held_now, self._target_turn(targets, all_v[:-1]), 0.0)
        for target in torch.split(target_turns, 1):
            turns.append(self._follow_turn(turns[-1], target, dt_s))
        all_w = torch.cat(turns)
        way, turned = 0.5 * dt_s * (all_v[:-1] + all_v[1:]), 0.5 * dt_s * (all_w[:-1] + all_w[1:])
        yaw = places[2] + turned.cumsum(0)
        heading = yaw - 0.5 * turned
        x, y = (way * torch.cos(heading)).cumsum(0), (way * torch.sin(heading)).cumsum(0)
        return places[0] + x, places[1] + y, yaw

    def _follow_speed(self, v: Tensor, a: Tensor, gap: Tensor, dt_s: float) -> Pair:
        """Speed and acceleration `dt_s` later; repeats `joystick.advance_speed`, given the gap."""
        limits, jerk = self._limits, self._limits[JERK]
        limit = torch.where(v * gap < 0.0, limits[DECEL], limits[ACCEL])
        ahead = gap - a * dt_s
        target = torch.sign(ahead) * torch.minimum(limit, (ahead.abs() * (2.0 * jerk)).sqrt())
        a = a + (target - a).clamp(-jerk * dt_s, jerk * dt_s)
        move = a * dt_s
        there = (gap.abs() <= move.abs() + STILL_MPS * dt_s) & (a.abs() <= 2.0 * jerk * dt_s + 0.1)
        return v + torch.where(there, gap, move), torch.where(there, 0.0, a)

    def _target_turn(self, targets: Pair, v: Tensor) -> Tensor:
        """The turn rate that is demanded at a speed; repeats `joystick.compute_yaw_rate_limit`."""
        faster = torch.maximum(targets[0].abs(), v.abs())
        return targets[1] / (1.0 + self._limits[YAW_SLOWDOWN] * faster)

    def _follow_turn(self, w: Tensor, target: Tensor, dt_s: float) -> Tensor:
        """The turn rate `dt_s` later; repeats `joystick.move_towards`."""
        most = self._limits[YAW_ACCEL] * dt_s
        return w + (target - w).clamp(-most, most)


class DangerPolicyGraph(nn.Module):
    """One tick of a danger policy; every state is zero at the start of an episode.

    It repeats `DangerPolicy` and all that this calls; only the network is the same object.

    Args:
        net: With its weights.
        config: Of the run.
        rule: From dangers to an action.

    Raises:
        PolicyError: The rule chooses by values.
    """

    outputs: Final = ("values", "warning", "danger")
    checked: Final = "danger"  # the output that is compared with the network's own
    # Share of the steps in which a place on the border of two cells may be read in the other.
    border_share: Final = 0.02
    window: Final = 1  # images that it looks at

    def __init__(self, net: DangerNet, config: RunConfig, rule: DangerRuleSettings) -> None:
        super().__init__()
        if rule.value is not None:
            raise PolicyError(
                "the policy chooses by the values of sticks (danger.teacher=returns), which no "
                "graph does; expected one with a threshold of danger: test it in wcsim"
            )
        chair = config.chair
        points = action_set(config.env.actions).points
        spec = plant_spec(chair)
        self.net, self.rule = net, rule
        self.delay, self.tick_s = config.world.action_delay_ticks, config.world.tick_s
        self.drive = TorchDriveModel(
            drive_limits_from_chair(chair), chair.deadband, chair.shape_exponent
        )
        # As `CameraView` sees: every so many pixels, depths short of the camera's range.
        # A network of one camera sees that alone.
        eyes = dict(list(config.eyes.items())[: 1 + len(net.spec.more_cameras)])
        pictures = (prefix + key for prefix in eyes for key in (DEPTH_KEY, CLASS_KEY))
        self.inputs = (*pictures, IMU_KEY, ODOMETRY_KEY, JOYSTICK_KEY)
        self.strides = [sampling_stride_px(camera) for camera in eyes.values()]
        rays = [
            viewing_rays(camera)
            .reshape(camera.height_px, camera.width_px, 3)[::stride, ::stride]
            .reshape(-1, 3)
            for camera, stride in zip(eyes.values(), self.strides, strict=True)
        ]
        # Pixels of all cameras are rows of one table.
        counts = [len(each) for each in rays]
        self.rays = _constant(np.concatenate(rays))
        self.eye = _constant(np.repeat([camera.p_BC_m for camera in eyes.values()], counts, 0))
        codes = np.arange(256, dtype=np.uint8)
        tables = [(decode_depth(codes, eye.range_m), eye.range_m) for eye in eyes.values()]
        # Beyond a camera's range there is nothing.
        near = [np.where(metres < FAR_SHARE * far_m, metres, 0.0) for metres, far_m in tables]
        self.metres = _constant(np.concatenate(near))
        self.kinds, self.movers = (
            _constant(street_map.kinds_of_ground()),
            _constant(street_map.movers()),
        )
        self.points = _constant(points)
        self.commands = _constant(shape_joysticks(points, chair))
        swept = street_map.hull_and_wheels(
            outline_to_box(spec.outline), np.array(spec.stand_m(), np.float64)
        )
        self.chair = _constant(swept)
        # (steps, 1, n) where in flat maps the one of each step and point of the chair starts.
        each_slice = np.repeat(np.arange(street_map.SLICES), street_map.EACH_SLICE)[:, None, None]
        self.plane = _constant(
            street_map.SIDE
            * street_map.SIDE
            * (each_slice + street_map.SLICES * (swept[:, 2] > 0.0))
        )
        self.cells_B = _constant(_picture_cells_B())

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The shapes of all states."""
        return {
            # See the names of its columns.
            "state_motion": (1, 8),
            # Sent and not yet measured; the oldest one is the last that was obeyed.
            "state_waiting": (1, self.delay + 1, 2),
            "state_sent": (1, street_map.COMMANDS, 2),
            # The last action, counted from 1.
            "state_last": (1, 1),
            "state_cells": (1, 6, street_map.RASTER * street_map.RASTER),
            # Smoothed danger of the user's own stick, and whether it warns.
            "state_alarm": (1, 2),
            # See `policy._next_recent`.
            "state_recent": (1, 1),
        }

    def forward(self, *given: Tensor) -> tuple[Tensor, ...]:
        """Values (1, A), warning (1, 1), dangers (1, A), and the next states.

        Inputs and states are in their order.

        Repeats `DangerPolicy.act`: what it observes, chooses and sends.
        """
        pictures = given[: 2 * len(self.strides)]
        imu, odometry, joystick, *states = given[len(pictures) :]
        motion, waiting, sent, last, cells, alarm, recent = states
        # 1. Observe: how the chair moves, then what its cameras show.
        shaped = self.drive.shaped(joystick)
        motion, waiting = self._observe_motion(imu, odometry, shaped, motion, waiting)
        cells = self._write_cells(pictures[::2], pictures[1::2], motion, cells)
        codes = self._read_cells(motion, cells)
        # 2. Roll every action out from where the next command reaches the chair.
        places, start = self._start(motion, waiting)
        holds = [
            step * street_map.STEP_S < street_map.HOLD_S - 1e-9
            for step in range(street_map.SLICES * street_map.EACH_SLICE)
        ]
        rolled = self.drive.roll_out(places, start, self.commands, holds, street_map.STEP_S)
        # 3. Dangers, and the action that the rule chooses.
        # The vector is that of `FeatureExtractor.extract`.
        turned = 10.0 * imu[:, street_map.TILT], imu[:, street_map.TURNS]
        scaled = motion[:, _MOTION] / motion.new_tensor(street_map.FULL_MOTION)
        later_s = motion.new_full((1, 1), self.delay * self.tick_s)
        vector = torch.cat([*turned, scaled, later_s, sent.reshape(1, -1)], 1).clamp(-2.0, 2.0)
        danger = torch.sigmoid(self.net(codes[None] / 255.0, vector, self._sweep(rolled)))
        values, recent = self._choose(danger, joystick, last, recent)
        action = values.argmax(dim=1)
        own = ((self.points[None] - joystick[:, None]) ** 2).sum(-1).argmin(dim=1)
        alarm = _next_alarm(alarm, danger.gather(1, own[:, None]), self.rule.warn)
        # 4. Send it, to the drive as shaped, to the next ticks' vectors as the stick itself.
        chosen = self.commands[action][:, None]
        waiting = torch.cat([waiting[:, 1:], chosen], 1)
        sent = torch.cat([self.points[action][:, None], sent[:, :-1]], 1)
        last = (action[:, None] + 1).to(torch.float32)
        return values, alarm[:, 1:2], danger, motion, waiting, sent, last, cells, alarm, recent

    def _observe_motion(
        self, imu: Tensor, odometry: Tensor, shaped: Tensor, motion: Tensor, waiting: Tensor
    ) -> Pair:
        """Repeats `EgoMotionEstimator.observe`: computes both of its branches, and selects one."""
        started = motion[:, _STARTED] > 0.5
        measured = torch.cat(
            [odometry[:, 0:1] * SPEED_FULL_SCALE, imu[:, GYRO_Z : GYRO_Z + 1] * TURN_FULL_SCALE], 1
        )
        # 1. A later tick: the drive's law, corrected towards what is measured.
        v, w, a = (motion[:, column] for column in (5, 6, 7))
        after = self.drive.follow((v, w, a), self.drive.targets(waiting[:, 0]), self.tick_s)
        mean = 0.5 * torch.stack([v + after[0], w + after[1]], 1)
        corrected = torch.stack(after[:2], 1) + TRUST * (measured - mean)
        now = torch.cat([corrected, after[2][:, None]], 1)
        way, turn = measured[:, 0:1] * self.tick_s, measured[:, 1:2] * self.tick_s
        heading = motion[:, 4:5] + 0.5 * turn
        pose = motion[:, _POSE] + torch.cat(
            [way * torch.cos(heading), way * torch.sin(heading), turn], 1
        )
        # 2. The first tick: a chair that moves already obeyed the user's stick so far.
        fresh = torch.cat([measured, torch.zeros_like(measured[:, :1])], 1)
        moves = (measured[:, 0:1].abs() > MOVES_MPS).to(measured.dtype)
        first_waiting = (shaped * moves)[:, None].expand_as(waiting)
        later = torch.cat([torch.ones_like(way), motion[:, _NOW] + 1.0, pose, now], 1)
        first = torch.cat(
            [torch.ones_like(way), torch.ones_like(way), torch.zeros_like(pose), fresh], 1
        )
        return (
            torch.where(started, later, first),
            torch.where(started[:, None], waiting, first_waiting),
        )

    def _write_cells(
        self, depths: Sequence[Tensor], segs: Sequence[Tensor], motion: Tensor, cells: Tensor
    ) -> Tensor:
        """Repeats `street_map._write_cells`: scattered maxima replace its loop over pixels."""
        tick = motion[:, _NOW]
        # 1. Which pixels are used, and in which cell of O each is.
        codes = self._sampled(depths)
        metres = self.metres[torch.cat([256 * n + codes[n] for n in range(len(codes))])]
        place = self.eye + metres[:, None] * self.rays
        classes = torch.cat(self._sampled(segs))
        kind, may_move = self.kinds[classes], self.movers[classes]
        used = (metres > 0.0) & (place[:, 2] <= street_map.HEAD_M)
        used = used & (place[:, :2].abs().amax(dim=1) <= street_map.REACH_M)
        ix, iy = _cells_in_O(motion, place[:, 0], place[:, 1])
        # What is not used goes into one more cell, which is dropped.
        slots_and_rest = street_map.RASTER * street_map.RASTER + 1
        slot = torch.where(
            used,
            _wrapped(ix, iy, street_map.RASTER),
            torch.full_like(ix, street_map.RASTER * street_map.RASTER),
        ).to(torch.int64)
        # 2. The most of each number in each cell.
        order = torch.arange(len(kind), dtype=kind.dtype, device=kind.device)
        # The last pixel of a cell that has a kind decides, as in a loop.
        kinds = torch.where(kind > 0, 8.0 * order + kind, torch.zeros_like(kind))
        moving = may_move * (place[:, 2] > street_map.MOVER_M).to(kind.dtype)
        numbers = torch.stack(
            [_wrapped(ix, iy, _KEY_SIDE), moving, kinds, place[:, 2], -place[:, 2]]
        )
        # The five numbers lie behind one another: ONNX scatters along one dimension only.
        empty = numbers.new_full((5 * slots_and_rest,), _EMPTY)
        slots = torch.cat([slot + number * slots_and_rest for number in range(5)])
        most = empty.scatter_reduce(
            0, slots, numbers.reshape(-1), reduce="amax", include_self=True
        ).view(5, -1)[:, :-1]
        # 3. Seen cells replace older ones; a mover of the same place is remembered.
        key, moving, kinds, high, low = (most[number] for number in range(5))
        old = cells[0]
        seen = high > 0.5 * _EMPTY
        same = (old[_KEY] == key) & (old[_TICK] > 0.0)
        now = tick[0].expand_as(high)
        mover = torch.where(
            moving > 0.5, now, torch.where(same, old[_MOVER], torch.zeros_like(high))
        )
        kinds = kinds - 8.0 * torch.floor(kinds / 8.0)
        return torch.where(seen, torch.stack([key, now, mover, kinds, high, -low]), old)[None]

    def _sampled(self, images: Sequence[Tensor]) -> list[Tensor]:
        """Repeats `CameraView._sampled`: (n,) int64 of each camera, together one for each ray."""
        return [
            image[..., ::stride, ::stride].reshape(-1).to(torch.int64)
            for image, stride in zip(images, self.strides, strict=True)
        ]

    def _read_cells(self, motion: Tensor, cells: Tensor) -> Tensor:
        """Repeats `street_map._read_cells`: (PLANES, SIDE, SIDE) in 0..255."""
        ix, iy = _cells_in_O(motion, self.cells_B[:, 0], self.cells_B[:, 1])
        found = cells[0].index_select(1, _wrapped(ix, iy, street_map.RASTER).to(torch.int64))
        known = (found[_TICK] > 0.0) & (found[_KEY] == _wrapped(ix, iy, _KEY_SIDE))
        tick = motion[0, 1]
        age, trail = tick - found[_TICK], tick - found[_MOVER]
        fresh = (known & (age <= street_map.KEEP_TICKS)).to(ix.dtype)
        moved = (known & (found[_MOVER] > 0.0) & (trail <= street_map.TRAIL_TICKS)).to(ix.dtype)
        planes = torch.stack(
            [
                fresh * _height_code(found[_HIGH]),
                fresh * _height_code(found[_LOW]),
                fresh * (255.0 - 5.0 * age),
                moved * (255.0 - 12.0 * trail),
                fresh * 60.0 * found[_CLASS],
            ]
        )
        return planes.reshape(street_map.PLANES, street_map.SIDE, street_map.SIDE)

    def _start(self, motion: Tensor, waiting: Tensor) -> tuple[Places, Motion]:
        """Repeats `StreetPerception.start`: (1,) each, when the next command reaches the chair."""
        here = torch.zeros_like(motion[:, 0])
        places, now = (here, here, here), (motion[:, 5], motion[:, 6], motion[:, 7])
        for number in range(self.delay):
            places, now = self.drive.advance(places, now, waiting[:, number + 1], self.tick_s)
        return places, now

    def _sweep(self, rolled: Places) -> Tensor:
        """Repeats `street_map.sweep`, for the places of a roll-out: (1, A, n) int64."""
        x, y, yaw = (part[:, :, None] for part in rolled)
        cos, sin = torch.cos(yaw), torch.sin(yaw)
        x = x + cos * self.chair[:, 0] - sin * self.chair[:, 1]
        y = y + sin * self.chair[:, 0] + cos * self.chair[:, 1]
        row = (
            street_map.SIDE - 1 - torch.floor((x + street_map.BEHIND_M) / street_map.CELL_M)
        ).clamp(0, street_map.SIDE - 1)
        column = torch.floor((street_map.HALF_M - y) / street_map.CELL_M).clamp(
            0, street_map.SIDE - 1
        )
        found = self.plane + row * street_map.SIDE + column
        return found.transpose(0, 1).reshape(1, len(self.commands), -1).to(torch.int64)

    def _choose(self, danger: Tensor, joystick: Tensor, last: Tensor, recent: Tensor) -> Pair:
        """Repeats `policy._choose`, `_mask_safe_actions` and `_next_recent`.

        A graph has no early return, so the branches of the rule become values (1, A), whose highest
        is that of the chosen action.
        """
        rule = self.rule
        distance = ((self.points[None] - joystick[:, None]) ** 2).sum(-1).sqrt()
        distance = distance.clamp(max=MAX_DISTANCE)
        numbers = torch.arange(1, len(self.points) + 1, dtype=danger.dtype, device=danger.device)
        numbers = numbers[None]
        # 1. What each action costs; the last one is favoured.
        is_last = (numbers == last).to(danger.dtype)
        cost = distance + rule.danger_cost * danger / rule.threshold - rule.hysteresis * is_last
        own = numbers == distance.argmin(dim=1, keepdim=True) + 1
        # 2. Which actions are safe enough, as `_mask_safe_actions`.
        taken = ((recent > 1.5) & own & (numbers != last)).to(danger.dtype)
        limit = (
            rule.threshold
            * (1.0 + (rule.hysteresis_factor - 1.0) * is_last)
            * (1.0 - (1.0 - GIVES_BACK) * taken)
        )
        limit = torch.where((recent < 0.5) & own, takes_away_at(rule), limit)
        # The user's own action wins wherever it is allowed.
        cost = torch.where(own, torch.full_like(cost, -1e6), cost)
        allowed = danger < limit
        doubtful = (recent < 0.5) & (danger < rule.at_once)
        # 3. For how long the own action stays taken away, as `_next_recent`.
        unsafe = (own & ~allowed).any(dim=1, keepdim=True)
        sure = (own & ~doubtful).any(dim=1, keepdim=True).to(recent.dtype)
        later = torch.where(
            unsafe, 1.0 + (RECENT_TICKS - 1.0) * sure, (recent - 1.0).clamp(min=0.0)
        )
        # 4. The choice; where nothing is allowed, the least dangerous action.
        allowed = allowed | (own & doubtful)
        nothing = ~allowed.any(dim=1, keepdim=True)
        cost = torch.where(allowed, cost, torch.full_like(cost, 1e6))
        return -torch.where(nothing, danger + DANGER_PER_DISTANCE * distance, cost), later


class ValuePolicyGraph(nn.Module):
    """One tick of a network of Q-learning; every state is zero at the start of an episode.

    Args:
        net: With its weights.
        window: Images that it looks at; 1 if it carries a state.
        tolerated_loss: It warns of a stick that is worth less than the best action by more.
    """

    outputs: Final = ("values", "warning")
    checked: Final = "values"
    border_share: Final = 0.0

    def __init__(self, net: QNet, window: int, tolerated_loss: float) -> None:
        """Raises PolicyError for a network that sees something else than classes and depth."""
        if net.encoder.form != "compact":
            raise PolicyError(
                f"a network that sees env.observation={net.encoder.form} cannot be exported; "
                "expected compact"
            )
        super().__init__()
        self.net, self.window, self.tolerated_loss = net, window, tolerated_loss
        # Of float64, as `ActionSet.nearest` compares: of two that are nearly as near, the same.
        self.points = nn.Buffer(torch.tensor(action_set(net.spec.actions).points), persistent=False)
        self.inputs = (DEPTH_KEY, CLASS_KEY, *net.encoder.vector_keys)

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The shapes of all states."""
        # Smoothed danger of the user's own stick, and whether it warns.
        shapes: dict[str, tuple[int, ...]] = {"state_alarm": (1, 2)}
        if self.net.spec.stateful:
            shapes["state_memory"] = (1, self.net.encoder.state_size)
        elif self.window > 1:
            # Depth and classes of the earlier pictures, each number one higher: 0 is no picture.
            size = image_size_from_space(self.net.observation_space)
            shapes["state_pictures"] = (1, 2, self.window - 1, *size)
        return shapes

    def forward(self, *given: Tensor) -> tuple[Tensor, ...]:
        """Values (1, A), warning (1, 1), next states; inputs and states are in their order."""
        seen = dict(zip(self.inputs, given, strict=False))
        alarm, *memory = given[len(self.inputs) :]
        # 1. The values, as the network is called in a world.
        if self.net.spec.stateful:
            values, *memory = self.net.step(seen, *memory)
        elif not memory:
            values = self.net(seen)
        else:
            (earlier,) = memory
            newest = torch.stack([seen[DEPTH_KEY], seen[CLASS_KEY]], 1).to(torch.float32) + 1.0
            # The first picture of an episode fills the window, as in `FrameStacker`.
            pictures = torch.cat([torch.where(earlier > 0.0, earlier, newest), newest], 2)
            depth, classes = (pictures - 1.0).unbind(1)
            values = self.net({**seen, DEPTH_KEY: depth, CLASS_KEY: classes})
            memory = [pictures[:, :, 1:]]
        # 2. The warning, as in `_NetPolicy.act`.
        stick = seen[JOYSTICK_KEY].to(torch.float64)
        own = ((self.points[None] - stick[:, None]) ** 2).sum(-1).argmin(dim=1)
        lost = values.amax(dim=1, keepdim=True) - values.gather(1, own[:, None])
        alarm = _next_alarm(alarm, (lost > self.tolerated_loss).to(alarm.dtype), TWO_TICKS)
        return values, alarm[:, 1:2], alarm, *memory


def _constant(numbers: np.ndarray) -> Tensor:
    """Numbers that a graph never changes, float32; no file of weights holds them."""
    return nn.Buffer(torch.from_numpy(np.ascontiguousarray(numbers, np.float32)), persistent=False)


def _next_alarm(before: Tensor, danger: Tensor, warn: float) -> Tensor:
    """Repeats `alarm.next_alarm_state`: smoothed danger and alarm (1, 2); danger (1, 1)."""
    level = before[:, 0:1] + NEWEST * (danger - before[:, 0:1])
    on = (level > warn) | ((before[:, 1:2] > 0.5) & (level > CALM * warn))
    return torch.cat([level, on.to(level.dtype)], 1)


def _cells_in_O(motion: Tensor, x_B_m: Tensor, y_B_m: Tensor) -> Pair:
    """The cells of O in which places of B lie."""
    cos, sin = torch.cos(motion[0, 4]), torch.sin(motion[0, 4])
    x = motion[0, 2] + cos * x_B_m - sin * y_B_m
    y = motion[0, 3] + sin * x_B_m + cos * y_B_m
    return torch.floor(x / street_map.CELL_M), torch.floor(y / street_map.CELL_M)


def _wrapped(ix: Tensor, iy: Tensor, side: float) -> Tensor:
    """The number of a cell, row by row, in a square of `side` cells each way that wraps around."""
    return (ix - side * torch.floor(ix / side)) * side + (iy - side * torch.floor(iy / side))


def _height_code(height_m: Tensor) -> Tensor:
    """Repeats `street_map._height_code`."""
    return 1.0 + torch.floor(
        254.0 * ((height_m - street_map.LOW_M) / street_map.SPAN_M).clamp(0.0, 1.0)
    )


def _picture_cells_B() -> np.ndarray:
    """(SIDE * SIDE, 2) middles of the picture's cells in B, in the order of its pixels."""
    rows, columns = np.meshgrid(
        np.arange(street_map.SIDE), np.arange(street_map.SIDE), indexing="ij"
    )
    x = (street_map.SIDE - rows - 0.5) * street_map.CELL_M - street_map.BEHIND_M
    y = street_map.HALF_M - (columns + 0.5) * street_map.CELL_M
    return np.stack([x.reshape(-1), y.reshape(-1)], 1)
