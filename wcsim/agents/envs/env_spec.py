"""What all environments of a town share: configuration, spaces, the order for a world, its chairs.

There are four, of the same links: Gymnasium's (`agents/envs/wheelchair_env.py`), PettingZoo's
(`agents/envs/parallel_env.py`), that of Gymnasium's vector environments
(`agents/envs/vector_env.py`) and that of Stable-Baselines3's (`agents/envs/vec_env.py`).
"""

import copy
import operator
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, TypedDict

import numpy as np
from gymnasium import spaces

from wcsim.agents.envs.episode_view import (
    EnvObservation,
    EnvStepResult,
    Info,
    SeatEnvAdapter,
    window_observation_space,
)
from wcsim.config import RunConfig, resolve
from wcsim.core.reading import MAX_INTEGER, escape_repr
from wcsim.errors import ConfigError, ProtocolError, meant
from wcsim.server.links.base import SeatLink, SeatLinkGroup, open_seat_links
from wcsim.server.specs import WorldBuildSpec, seat_spec_from_env
from wcsim.supervisor.actions import action_set
from wcsim.supervisor.observation import (
    count_imu_values,
    make_observation_space,
    make_state_observation_space,
)
from wcsim.supervisor.rewards import RewardTerm, is_reward_term
from wcsim.users.recordings.recorded_user import find_user

RENDER_MODES: Final = ("rgb_array",)
RENDER_FPS: Final = 10  # of a tick of 0.1 s; an environment has the one of its own tick
SEED_LIMIT: Final = 1 << 31
MAX_CHAIRS: Final = 64  # of one world
TASK: Final = "drive"
TASK_DESCRIPTION: Final = "Drive where the wheelchair's user wants to go, without a crash."


class EnvOptions(TypedDict, total=False):
    """The keyword arguments of every environment of a town; all are optional."""

    config: RunConfig | None
    """A resolved configuration, instead of a preset."""
    preset: str
    """Name of a preset, "quick" by default."""
    overrides: Sequence[str]
    """Settings that override the configuration or preset: "section.key=value"."""
    seed: int | None
    """Seed of the first reset if that gives none. Without both, the seed is random."""
    reward_terms: Sequence[RewardTerm]
    """Your own terms, added to the reward as `RewardTerms.extra`. Each chair has its own copies."""
    render_mode: str | None
    """None or "rgb_array". With the latter, cameras also render colours."""
    run: Path | None
    """Run folder for the outputs of the SUMO scenario; else they are deleted with the world."""
    hook: str
    """Your own step hook "module:Class", called around every SUMO step; see docs/overrides.md."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StreetEnvSettings:
    """A town, its configuration, and the place of its outputs."""

    town: str
    config: RunConfig
    render_mode: str | None = None
    run: Path | None = None
    hook: str = ""

    @property
    def metadata(self) -> dict[str, Any]:
        """The metadata of Gymnasium and PettingZoo."""
        # Films take as long as what they show.
        fps = max(1, round(1 / self.config.world.tick_s))
        return {"render_modes": list(RENDER_MODES), "render_fps": fps, "name": "wcsim"}

    def action_space(self) -> spaces.Discrete | spaces.Box:
        """The space of one chair's actions, a new one each time."""
        if self.config.env.actions == "stick":
            return spaces.Box(-1.0, 1.0, (2,), np.float32)
        return spaces.Discrete(len(action_set(self.config.env.actions)))

    def observation_space(self) -> spaces.Dict | spaces.Box:
        """The space of one chair's observations, a new one each time."""
        env = self.config.env
        if env.observation == "state":
            return make_state_observation_space()
        others = self.config.eyes
        camera = others.pop("")
        single = make_observation_space(
            env.observation,
            camera.width_px,
            camera.height_px,
            count_imu_values(env.observe_gyro, env.observe_yaw),
            self.config.sensors.measures(),
            others,
        )
        return window_observation_space(single, env.frames)

    def order(self, seed: int, chairs: int = 1) -> WorldBuildSpec:
        """The order for a world with so many seats."""
        return WorldBuildSpec(
            town=self.town,
            config=self.config,
            seat=seat_spec_from_env(self.config.env),
            seats=chairs,
            seed=seed % SEED_LIMIT,
            run="" if self.run is None else str(self.run),
            hook=self.hook,
        )


def make_env_settings(
    town: str, options: EnvOptions, own: Collection[str] = ("town",)
) -> StreetEnvSettings:
    """What the options of an environment describe.

    Args:
        town: A town's name or folder.
        options: By name.
        own: Further keyword arguments of the environment.

    Raises:
        ConfigError: The configuration, a reward term, the user's profile or the render mode cannot
            be used.
        TypeError: There is no such option.
    """
    known = sorted({*EnvOptions.__annotations__, *own})
    for name in options:
        if name not in known:
            raise TypeError(
                f"unexpected keyword argument {name!r}; expected {', '.join(known)}"
                f"{meant(name, known)}"
            )
    terms: object = options.get("reward_terms", ())
    if not isinstance(terms, Sequence) or any(
        isinstance(term, type) or not is_reward_term(term) for term in terms
    ):
        raise ConfigError(
            f"reward_terms={escape_repr(terms)}; expected a list of objects with the methods "
            "reset() and reward(before, after), see examples/own_reward.py"
        )
    config = options.get("config")
    if config is not None and "preset" in options:
        raise ConfigError(
            f"config and preset={options['preset']!r}: expected one of them; a preset's "
            "configuration is wcsim.config.resolve(preset)"
        )
    overrides = options.get("overrides", ())
    # The characters of a string would be taken for overrides.
    if isinstance(overrides, str):
        raise ConfigError(
            f"overrides={escape_repr(overrides)} is one string; expected several: "
            f"overrides=[{overrides!r}]"
        )
    resolved = resolve(
        options.get("preset", "quick") if config is None else config, tuple(overrides)
    )
    find_user(resolved.env.profile)
    render_mode = options.get("render_mode")
    if render_mode not in (None, *RENDER_MODES):
        raise ConfigError(f"render_mode {render_mode!r} is unknown; expected 'rgb_array' or None")
    if render_mode == "rgb_array":
        resolved = resolve(resolved, f"cameras.{resolved.cameras.index(resolved.eye)}.rgb=true")
    return StreetEnvSettings(
        town=town,
        config=resolved,
        render_mode=render_mode,
        run=options.get("run"),
        hook=options.get("hook", ""),
    )


def refuse_reset_options(names: Iterable[str]) -> None:
    """Raise ConfigError for any name: no reset takes options, as environments take them."""
    for name in names:
        raise ConfigError(
            f"reset() got the option {escape_repr(name)}; expected none: what can be set, an "
            f"environment is made with{meant(str(name), ('town', *EnvOptions.__annotations__))}"
        )


def validate_seed(seed: object) -> int | None:
    """A seed, or None. Raises ConfigError for one that is no integer from 0 on."""
    if seed is None:
        return None
    try:
        number = operator.index(seed)  # type: ignore[arg-type]
    except TypeError:
        number = -1
    if not 0 <= number <= MAX_INTEGER:
        raise ConfigError(
            f"seed {escape_repr(seed)} cannot be used; expected an integer from 0 to {MAX_INTEGER}"
        )
    return number


def stack_observations(observations: Sequence[EnvObservation]) -> EnvObservation:
    """One observation of all chairs, in new arrays with one more axis, the first."""
    first = observations[0]
    if not isinstance(first, dict):
        return np.stack(observations)  # type: ignore[arg-type]
    return {key: np.stack([each[key] for each in observations]) for key in first}  # type: ignore[call-overload]


def draw_random_seed() -> int:
    """A seed drawn from the system, where none is given."""
    return int(np.random.SeedSequence().generate_state(1)[0]) % SEED_LIMIT


class ChairGroup:
    """All chairs of a world, by seat; the world is made by the first `begin`."""

    def __init__(self, spec: StreetEnvSettings, count: int, options: EnvOptions) -> None:
        """So many chairs, each with its own copy of the user's reward terms, which have a state.

        Raises ConfigError for a number of chairs that no world can have, or a seed that is none.
        """
        if not 1 <= count <= MAX_CHAIRS:
            raise ConfigError(f"chairs={count}; expected 1 to {MAX_CHAIRS} in one world")
        self.spec = spec
        terms = tuple(options.get("reward_terms", ()))
        self.all = [SeatEnvAdapter(spec.config, copy.deepcopy(terms)) for _ in range(count)]
        self._group: SeatLinkGroup | None = None
        self.first_seed = validate_seed(options.get("seed"))

    def __getstate__(self) -> dict[str, Any]:
        """For copies. Raises ProtocolError while there is a world: several have no replay."""
        if self._group is not None:
            raise ProtocolError(
                "several chairs in an open world cannot be copied; call close() first, or copy one"
            )
        return self.__dict__

    @property
    def open(self) -> bool:
        """Whether there is a world, and no step of it was interrupted."""
        return self._group is not None and not any(link.interrupted for link in self._group.links)

    def begin(self, seed: int | None) -> list[tuple[EnvObservation, Info]]:
        """Begin every chair's next episode: without a tick, but with a seed in a new world.

        The first world has the first seed; without one, a seed is drawn.
        """
        if seed is None and self._group is not None and self.open:
            frames = self._group.respawn()
        else:
            seed = self.first_seed if seed is None else seed
            seed = (draw_random_seed() if seed is None else seed) % SEED_LIMIT
            if not self.open:
                self.close()
            if self._group is None:
                self._group = open_seat_links(self.spec.order(seed, len(self.all)))
                frames = self._group.join()
            else:
                frames = self._group.begin_again(seed)
        return [chair.begin(frame) for chair, frame in zip(self.all, frames, strict=True)]

    def send(self, seat: int, action: object) -> None:
        """Send a chair's action. Raises BadActionError for one that is not in the set."""
        command = self.all[seat].command(action)
        self.link(seat).send(command.tick, command.joystick)

    def send_all(self, actions: object) -> None:
        """Send every chair's action, (N,) indices or (N, 2) sticks.

        Raises ProtocolError for another number of them, BadActionError for a wrong one; then
        nothing has moved.
        """
        rows = np.asarray(actions, object)
        rows = np.atleast_1d(rows) if self.spec.config.env.actions == "stick" else rows.reshape(-1)
        if len(rows) != len(self.all):
            raise ProtocolError(
                f"{len(rows)} actions; expected {len(self.all)}, one for each chair"
            )
        # All are checked before the first is sent.
        commands = [chair.command(action) for chair, action in zip(self.all, rows, strict=True)]
        for seat, command in enumerate(commands):
            self.link(seat).send(command.tick, command.joystick)

    def receive(self, seat: int) -> EnvStepResult:
        """The result of a chair's action. Raises LinkError."""
        return self.all[seat].finish_step(self.link(seat).receive())

    def receive_all(self) -> list[tuple[EnvStepResult, tuple[EnvObservation, Info] | None]]:
        """The results of all actions, and the first frame of the next episode where one ended."""
        steps = [self.receive(seat) for seat in range(len(self.all))]
        return [
            (step, chair.begin_next() if step.done else None)
            for chair, step in zip(self.all, steps, strict=True)
        ]

    def link(self, seat: int) -> SeatLink:
        """The link of a seat. Raises ProtocolError when there is no world."""
        if self._group is None:
            raise ProtocolError("step() came before reset(); call reset() first")
        return self._group.links[seat]

    def close(self) -> None:
        """End the world; a second call does nothing."""
        group = self._group
        self._group = None
        for chair in self.all:
            chair.now = None
        if group is not None:
            group.close()
