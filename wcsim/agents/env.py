"""One wheelchair as a Gymnasium environment: `gymnasium.make("wcsim/Street-v1", town="helsinki")`.

The world behind it lives in this process when none does yet, otherwise in a process of its own; trajectories are the
same to the bit. A finished chair is respawned by the world within the tick that ended it, so `reset()` without a seed
only hands out the frame that is already there; `reset(seed=s)` makes the whole world anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt

from wcsim.config import RunConfig, load_run_config
from wcsim.errors import ConfigError, ProtocolError
from wcsim.server.link import WorldLink, WorldOrder
from wcsim.server.open_link import open_link
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.judge import Judgement, judge, observation_of
from wcsim.supervisor.observation import Observation, imu_size, observation_space
from wcsim.supervisor.recorded import find_user
from wcsim.supervisor.reward_terms import RewardTerm
from wcsim.supervisor.rewards import DISTANCE_TOLERANCE
from wcsim.types import ClientSnapshot, Joystick, RewardTerms, SeatSpec

SEED_LIMIT = 1 << 31


class WheelchairEnv(gymnasium.Env[Observation, np.int64]):
    """Drive one wheelchair through a town; see the module's text."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 (Gymnasium's own attribute)

    def __init__(
        self,
        town: str = "helsinki",
        *,
        config: RunConfig | None = None,
        preset: str = "quick",
        overrides: Sequence[str] = (),
        seed: int | None = None,
        reward_terms: Sequence[RewardTerm] = (),
        render_mode: str | None = None,
        run: Path | None = None,
        hook: str = "",
    ) -> None:
        """Describe the environment; the world is made by the first reset.

        Args:
            town: A town's name or folder.
            config: A resolved configuration; `preset` and `overrides` ("section.key=value") make one otherwise.
            preset: Name of a preset.
            overrides: Laid over the preset.
            seed: Seed of the first reset when that brings none; drawn from the system when both are missing.
            reward_terms: The user's own terms; their sum is added to the reward as `RewardTerms.extra`.
            render_mode: None or "rgb_array" (the camera then draws colours too, for people to look at).
            run: A run folder for the outputs of the town's own SUMO scenario; without one they go with the world.
            hook: The user's own step hook as "module:Class", called around every step of SUMO; see docs/overrides.md.

        Raises:
            ConfigError: The configuration cannot be used.
        """
        self.config = config if config is not None else load_run_config(preset, tuple(overrides))
        find_user(self.config.env.profile)
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ConfigError(f"render_mode {render_mode!r} is unknown; expected 'rgb_array' or None")
        self.town = town
        self._run, self._hook = run, hook
        self.render_mode = render_mode
        if render_mode == "rgb_array":
            self.config = with_colours(self.config)
        camera, env = self.config.cameras[0], self.config.env
        self._actions = action_set(self.config.env.actions)
        self._terms = tuple(reward_terms)
        self._first_seed = seed
        self._link: WorldLink | None = None
        self._now: ClientSnapshot | None = None
        # Gymnasium types the space of a dictionary as a dictionary of spaces, which a Dict space is not.
        self.observation_space = observation_space(  # type: ignore[assignment]
            self.config.env.observation, camera.width_px, camera.height_px, imu_size(env.observe_gyro, env.observe_yaw)
        )
        self.action_space = gymnasium.spaces.Discrete(len(self._actions))

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begin an episode; with a seed, in a world made anew. Raises TownError when the town cannot be used."""
        super().reset(seed=seed)
        if self._link is None:
            self._now = self._open(seed if seed is not None else self._first_seed)
        elif seed is not None:
            self._now = self._link.rebuild(seed % SEED_LIMIT)
        elif self._now is not None and self._now.first is not None:
            self._now = self._now.first
        else:
            self._now = self._link.respawn()
        for term in self._terms:
            term.reset()
        return observation_of(self._now, self.config), self._info(self._now, None, 0.0)

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Drive for one tick; terminated by a crash only, truncated after `env.max_steps`."""
        if self._link is None or self._now is None or self._now.first is not None:
            raise ProtocolError("step() came before reset(), or after the episode's end; call reset() first")
        choice = int(action)
        if not 0 <= choice < len(self._actions):
            raise ProtocolError(f"action {choice} is not in the action set; expected 0 to {len(self._actions) - 1}")
        asked = self._now.user
        point = self._actions.points[choice]
        before = self._now
        self._now = self._link.act(before.tick, Joystick(float(point[0]), float(point[1])))
        judged = judge(self._now, choice, asked, self._actions.points, self.config)
        terms = self._with_own_terms(judged, before)
        distance = self._actions.distance(choice, (asked.x, asked.y))
        info = self._info(self._now, terms, distance)
        return judged.observation, float(terms.total), judged.terminated, judged.truncated, info

    def render(self) -> npt.NDArray[np.uint8] | None:
        """The first camera's picture (H, W, 3) uint8, in render mode "rgb_array"."""
        if self.render_mode != "rgb_array" or self._now is None:
            return None
        return self._now.sensors.cameras[0].rgb

    def close(self) -> None:
        """Leave the world; a second call does nothing."""
        if self._link is not None:
            self._link.close()
            self._link = None
            self._now = None

    def _open(self, seed: int | None) -> ClientSnapshot:
        drawn = np.random.SeedSequence().generate_state(1)[0] if seed is None else seed
        env = self.config.env
        order = WorldOrder(
            town=self.town,
            config=self.config,
            seat=SeatSpec(profile=env.profile, max_steps=env.max_steps, truth=env.truth),
            seed=int(drawn) % SEED_LIMIT,
            run="" if self._run is None else str(self._run),
            hook=self._hook,
        )
        self._link = open_link(order)
        return self._link.join()

    def _with_own_terms(self, judged: Judgement, before: ClientSnapshot) -> RewardTerms:
        if not self._terms or self._now is None:
            return judged.reward
        return replace(judged.reward, extra=sum(term.reward(before, self._now) for term in self._terms))

    def _info(self, snapshot: ClientSnapshot, terms: RewardTerms | None, distance: float) -> dict[str, Any]:
        plant = snapshot.plant
        return {
            "state": plant,
            "imu": snapshot.sensors.imu,
            "user_action": self._actions.nearest((snapshot.user.x, snapshot.user.y)),
            "joystick_distance": distance,
            "reward_terms": terms,
            "truth": snapshot.truth,
            "drawn": snapshot.drawn,
            "warning": snapshot.truth.danger if snapshot.truth else None,
            "intervening": distance > self.config.reward.max_follow_distance + DISTANCE_TOLERANCE,
            "events": snapshot.events,
            "contacts": snapshot.contacts,
            "progress_m": snapshot.events.progress_m,
            "speed_mps": float(np.hypot(plant.v_B_mps[0], plant.v_B_mps[1])),
        }


def with_colours(config: RunConfig) -> RunConfig:
    """The same configuration with colours drawn by its first camera."""
    first = config.cameras[0].model_copy(update={"rgb": True})
    return config.model_copy(update={"cameras": (first, *config.cameras[1:])})
