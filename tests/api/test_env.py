"""The environment as its users meet it: through `gymnasium.make`, Gymnasium's and Stable-Baselines3's checkers."""

import math
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from stable_baselines3.common.env_checker import check_env as sb3_check_env

import wcsim
from tests.api.streets import BOTH, Counting, action_at, equal
from wcsim.agents.envs.env_spec import EnvOptions
from wcsim.agents.envs.parallel_env import StreetParallelEnv
from wcsim.agents.envs.saving_env import SavingEnv
from wcsim.agents.envs.vec_env import StreetVecEnv
from wcsim.agents.envs.vector_env import StreetVectorEnv
from wcsim.agents.envs.wheelchair_env import WheelchairEnv
from wcsim.config import resolve
from wcsim.errors import BadActionError, ConfigError, ProtocolError, TownError
from wcsim.supervisor.rewards import make_reward_term
from wcsim.types import Events, ImuFrame, PlantState, RewardTerms

EXAMPLES = Path(__file__).parents[2] / "examples"
NO_WARMUP = "world.warmup_s=0"
TINY = ("cameras.0.width_px=32", "cameras.0.height_px=24")
INFO_KEYS = {
    *("state", "user_action", "joystick_distance", "intervening", "world_restarted", "objects"),
    *("contacts", "progress_m", "speed_mps", "asked", "given", "help", "is_success", "event_crash_reason"),
    *(f"event_{item.name}" for item in fields(Events) if item.type not in ("b.NameOrNone", "b.Line")),
    *(f"reward_{item.name}" for item in fields(RewardTerms)),
    *(f"imu_{item.name}" for item in fields(ImuFrame)),
}
NOT_AN_IMAGE = (
    "It seems that your observation {} is an image but its `dtype` is (float32)",
    "It seems that your observation space {} is an image but the upper and lower bounds are not in [0, 255]",
)

CLASSES = (WheelchairEnv, StreetParallelEnv, StreetVecEnv)
EACH_CHECKER = pytest.mark.parametrize("checker", [check_env, sb3_check_env], ids=["gymnasium", "sb3"])
Env = gymnasium.Env[Any, Any]
Shown = list[tuple[Any, ...]]
"""Frames: an observation, and what else is compared."""


@contextmanager
def made(town: Path, *overrides: str, sized: tuple[str, ...] = TINY, **more: Any) -> Iterator[Env]:
    env = gymnasium.make(wcsim.ENV_ID, town=str(town), overrides=(NO_WARMUP, *sized, *overrides), **more)
    try:
        yield env
    finally:
        env.close()


def drive(env: Env, steps: int, seed: int | None) -> Shown:
    """What a user sees of an episode that is driven by actions which depend on nothing but the step."""
    observation, info = env.reset(seed=seed)
    seen = [(observation, 0.0, False, False, info["objects"].state)]
    for step in range(steps):
        observation, reward, terminated, truncated, info = env.step(action_at(step))
        seen.append((observation, reward, terminated, truncated, info["objects"].state))
        if terminated or truncated:
            observation, info = env.reset()
            seen.append((observation, 0.0, False, False, info["objects"].state))
    return seen


def tick_of(env: Env) -> int:
    return env.unwrapped._chair.now.tick


def warnings_of(town: Path, checker: Any, *overrides: str) -> list[str]:
    """What a checker warns of, in pictures of the size that the presets use."""
    with warnings.catch_warnings(record=True) as caught, made(town, *overrides, sized=()) as env:
        warnings.simplefilter("always")
        checker(env.unwrapped)
    return [str(item.message) for item in caught]


@EACH_CHECKER
def test_checkers_find_nothing_in_the_compact_form(corner, checker):
    assert warnings_of(corner, checker) == []


def test_checkers_find_nothing_in_table_3_but_that_floats_are_no_stored_images(corner):
    form = 'env.observation="table3"'
    assert warnings_of(corner, check_env, form) == warnings_of(corner, check_env, form, "env.window=3") == []
    told = warnings_of(corner, sb3_check_env, form)
    expected = [text.format(name) for name in ("depth", "segmentation") for text in NOT_AN_IMAGE]
    assert len(told) == len(expected)
    assert all(got.startswith(text) for got, text in zip(told, expected, strict=True))


@EACH_CHECKER
def test_further_cameras_have_keys_of_their_own_and_checkers_find_nothing(corner, checker):
    two = 'env.camera=["front","rear"]'
    assert warnings_of(corner, checker, two) == []
    with made(corner) as one, made(corner, two, "env.window=2", 'env.observation="table3"') as env:
        fewer = set(one.observation_space.spaces)
        assert {*env.observation_space.spaces} == {*fewer - {"seg"}, "segmentation", "rear_segmentation", "rear_depth"}
        seen = env.reset(seed=5)[0]
        assert env.observation_space.contains(seen) and seen["rear_depth"].shape == seen["depth"].shape
        assert not np.array_equal(seen["rear_depth"], seen["depth"])


@pytest.mark.parametrize("form", ["compact", "compact_rgb", "table3"])
def test_observations_lie_in_their_space_and_are_the_callers_own(corner, form):
    with made(corner, "cameras.0.rgb=true", f'env.observation="{form}"') as env:
        seen = [item[0] for item in drive(env, 12, seed=5)]
        assert all(env.observation_space.contains(observation) for observation in seen)
        before = {key: value.copy() for key, value in seen[3].items()}
        drive(env, 5, seed=6)
        assert all(np.array_equal(seen[3][key], before[key]) for key in before)


def test_two_lines_are_enough_for_a_real_town():
    env = gymnasium.make(wcsim.ENV_ID, town="helsinki", overrides=("world.warmup_s=10",))
    try:
        observation, info = env.reset(seed=1)
        assert observation["seg"].shape == observation["depth"].shape == (1, 60, 80)
        assert len(np.unique(observation["seg"])) >= 3
        assert env.action_space == gymnasium.spaces.Discrete(81)
        _, reward, terminated, truncated, _ = env.step(info["user_action"])
        assert (reward, terminated, truncated) == (1.0, False, False)
    finally:
        env.close()


def test_one_seed_is_one_episode_and_another_seed_another(corner):
    with made(corner) as env:
        first = drive(env, 25, seed=5)
        assert equal(first, drive(env, 25, seed=np.int64(5)))
        assert not equal(first, drive(env, 25, seed=6))
    with made(corner, seed=5) as env:
        assert equal(first, drive(env, 25, seed=None))


def test_a_program_ends_though_its_second_world_died_and_nobody_closed_anything(corner):
    code = (
        "import gymnasium, wcsim\n"
        f"make = lambda: gymnasium.make(wcsim.ENV_ID, town={str(corner)!r}, overrides={(NO_WARMUP, *TINY)!r})\n"
        "one, two = make(), make()\n"
        "one.reset(seed=1); two.reset(seed=1)\n"
        "world = two.unwrapped._link._child.process; world.kill(); world.wait()\n"
        "two.step(44)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 1
    assert done.stderr.strip().splitlines()[-1].startswith("wcsim.errors.LinkClosedError: the world process ended")


def test_gymnasiums_own_vector_environments_work(corner):
    overrides = (NO_WARMUP, *TINY, "env.max_steps=4")
    vec = gymnasium.make_vec(wcsim.ENV_ID, num_envs=2, vectorization_mode="sync", town=str(corner), overrides=overrides)
    try:
        vec.reset(seed=3)
        for _ in range(6):
            observations, rewards, _, truncated, info = vec.step(BOTH)
        assert observations["depth"].shape == (2, 1, 24, 32)
        assert rewards.shape == truncated.shape == (2,)
        assert set(info) >= {"state", "event_step"}
    finally:
        vec.close()


def test_an_episode_is_cut_after_max_steps_and_the_next_one_is_there_already(corner):
    with made(corner, "env.max_steps=6") as env:
        env.reset(seed=2)
        for step in range(1, 7):
            _, _, terminated, truncated, info = env.step(40)
            assert not terminated
            assert truncated == (step == 6)
            assert info["event_step"] == step
        assert info["event_truncated"]
        tick = tick_of(env)
        _, info = env.reset()
        assert tick_of(env) == tick
        assert (info["event_episode"], info["event_step"]) == (1, 0)
        env.step(40)
        _, info = env.reset()  # in the middle of an episode
        assert (tick_of(env), info["event_episode"], info["event_step"]) == (tick + 1, 2, 0)
        assert env.step(40)[4]["event_step"] == 1


def test_step_out_of_turn_says_so(corner):
    with made(corner, "env.max_steps=1") as env:
        bare = env.unwrapped
        with pytest.raises(ProtocolError, match="call reset"):
            bare.step(0)
        bare.reset(seed=1)
        bare.step(0)
        with pytest.raises(ProtocolError, match="call reset"):
            bare.step(0)
        bare.reset()
        bare.step(0)
        bare.close()
        bare.close()
        with pytest.raises(ProtocolError, match="call reset"):
            bare.step(0)


@contextmanager
def interrupted(monkeypatch: pytest.MonkeyPatch, place: str) -> Iterator[None]:
    """While open, Ctrl-C comes where the world steps, or where it is waited for."""

    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(place, stop)
        yield


IN_THE_WORLD = "wcsim.bridge.world.World.tick"
FACES: tuple[tuple[Any, Any], ...] = (
    (WheelchairEnv, lambda env: env.step(40)),
    (StreetParallelEnv, lambda env: env.step(dict.fromkeys(env.agents, 40))),
    (StreetVecEnv, lambda env: env.step(np.full(2, 40))),
    (StreetVectorEnv, lambda env: env.step(np.full(2, 40))),
)


@pytest.mark.parametrize(("face", "step"), FACES, ids=lambda value: getattr(value, "__name__", ""))
def test_a_step_that_was_interrupted_is_gone_on_from_by_reset(corner, monkeypatch, face, step):
    env = face(str(corner), overrides=(NO_WARMUP, *TINY), seed=1)
    env.reset()
    for _ in range(2):
        with interrupted(monkeypatch, IN_THE_WORLD):
            step(env)
        with pytest.raises(ProtocolError, match="call reset"):
            step(env)
        env.reset()
        step(env)
    env.close()


def test_so_it_is_where_the_world_is_a_process_of_its_own_which_ctrl_c_is_not_for(corner, monkeypatch):
    """At a terminal it reaches every process of the group."""
    with made(corner) as first, made(corner, seed=1) as other:
        first.reset(seed=2)
        env = other.unwrapped
        env.reset()
        env._link._child.process.send_signal(signal.SIGINT)
        for _ in range(3):
            assert env.step(44)[4]["event_step"] == first.step(44)[4]["event_step"]
        with interrupted(monkeypatch, "wcsim.server.links.socket._ChildSeat._pump"):
            env.step(40)
        env.reset()
        env.step(40)


def test_a_closed_env_can_be_reset_again(corner):
    with made(corner) as env:
        first = drive(env, 3, seed=1)
        env.unwrapped.close()
        assert equal(first, drive(env, 3, seed=1))


@pytest.mark.parametrize("face", CLASSES)
@pytest.mark.parametrize("terms", [[3], 3, None, [object], "word"])
def test_what_is_no_reward_term_is_refused_when_the_environment_is_made(face, terms):
    with pytest.raises(ConfigError, match=r"reward_terms=.*; expected a list of objects with the methods reset"):
        face("nowhere", reward_terms=terms)


def test_info_says_what_is_promised(corner):
    with made(corner) as env:
        _, info = env.reset(seed=1)
        assert set(info) == INFO_KEYS
        assert info["objects"].reward_terms.total == 0.0
        assert not np.any([info["asked"], info["given"]])
        _, reward, _, _, info = env.step(info["user_action"])
        assert set(info) == INFO_KEYS
        objects = info["objects"]
        assert isinstance(objects.state, PlantState)
        assert isinstance(objects.events, Events)
        assert isinstance(objects.reward_terms, RewardTerms)
        assert objects.truth is None
        assert (
            reward
            == pytest.approx(objects.reward_terms.total)
            == sum(info[f"reward_{item.name}"] for item in fields(RewardTerms))
        )
        assert info["given"].tolist() == [objects.given.x, objects.given.y]
        assert 0.0 <= info["joystick_distance"] <= 2.0**1.5


def test_noise_turn_rates_and_heading_are_a_matter_of_configuration(corner):
    overrides = ("env.observe_gyro=true", "env.observe_yaw=true", "cameras.0.noise=typical")
    with made(corner, *overrides) as env:
        observation, info = env.reset(seed=1)
        assert env.observation_space.contains(observation)
        assert observation["imu"].shape == (10,)
        assert (observation["depth"] == 0).any()  # pixels without a measurement
        assert info["imu_yaw_rad"] == info["objects"].state.yaw_rad


def test_doing_what_the_user_asks_for_is_following_and_the_opposite_is_intervening(corner):
    with made(corner, 'env.profile="competent"') as env:
        _, info = env.reset(seed=1)
        for _ in range(20):
            _, reward, _, _, info = env.step(info["user_action"])
            assert info["joystick_distance"] <= 0.1768
            assert not info["intervening"]
            assert reward == 1.0
        _, _, _, _, info = env.step(0)  # full left and back, while the user drives ahead
        assert info["joystick_distance"] > 0.1768
        assert info["intervening"]


@pytest.mark.parametrize("setting", ["env.truth=true", "env.truth_visible=true"])
def test_truth_is_there_when_it_is_asked_for(corner, setting):
    with made(corner, setting) as env:
        _, info = env.reset(seed=1)
        for _ in range(15):
            _, _, _, _, info = env.step(info["user_action"])
        assert info["objects"].truth.safe_actions.shape == (env.action_space.n,)
        assert info["progress_m"] == info["objects"].truth.progress_m > 0.0
        assert info["warning"] == info["truth_danger"] == info["objects"].truth.danger
        visible = info["objects"].truth.visible
        assert (visible is None) == (setting == "env.truth=true")
        assert visible is None or visible.safe_actions.shape == (env.action_space.n,)


def test_render_shows_the_camera_in_colours(corner):
    with made(corner, render_mode="rgb_array") as env:
        env.reset(seed=1)
        env.step(40)
        picture = env.render()
        assert picture.shape == (24, 32, 3)
        assert picture.dtype == np.uint8
        assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 3
        coloured = drive(env, 8, seed=4)
    with made(corner) as env:
        assert equal(coloured, drive(env, 8, seed=4)), "colours change nothing but the picture"
        assert env.unwrapped.render() is None


def test_a_picture_that_is_kept_stays_what_it_was(corner):
    """Who films keeps them all, as `gymnasium.wrappers.RecordVideo` does."""
    with made(corner, render_mode="rgb_array") as env:
        env.reset(seed=1)
        kept = []
        for step in range(8):
            env.step(action_at(step))
            kept.append((env.render(), env.render().copy()))
    assert all(np.array_equal(picture, copied) for picture, copied in kept)


def test_an_own_reward_term_is_added(corner, monkeypatch):
    monkeypatch.chdir(EXAMPLES)
    with made(corner, reward_terms=(make_reward_term("own_reward:Gentle"),)) as env:
        _, info = env.reset(seed=1)
        total, before = 0.0, info["objects"].state.v_B_mps[0]
        for _ in range(15):
            _, reward, _, _, info = env.step(info["user_action"])
            terms, after = info["objects"].reward_terms, info["objects"].state.v_B_mps[0]
            assert terms.extra == pytest.approx(-0.1 * abs(after - before))
            paper = terms.base + terms.joystick + terms.accel + terms.tilt + terms.crash
            assert reward == pytest.approx(paper + terms.extra)
            total, before = total + terms.extra, after
        assert total < -0.05


def test_an_environment_has_copies_of_its_own_of_the_reward_terms(corner):
    term = Counting()
    with made(corner, reward_terms=[term]) as env:
        env.reset(seed=1)
        assert [env.step(44)[4]["reward_extra"] for _ in range(2)] == [1.0, 2.0]
    assert term.steps == 0, "another environment may have been given it as well"


def test_a_reward_term_that_cannot_be_copied_is_taken_as_it_is(corner, tmp_path):
    with (tmp_path / "log").open("w") as log:
        term = Counting()
        term.log = log
        with made(corner, reward_terms=[term]) as env:
            env.reset(seed=1)
            assert env.step(44)[4]["reward_extra"] == 1.0
    assert term.steps == 1


def test_the_smaller_action_set_has_its_size(corner):
    with made(corner, 'env.actions="disc69"') as env:
        assert env.action_space == gymnasium.spaces.Discrete(69)
        _, info = env.reset(seed=1)
        assert 0 <= info["user_action"] < 69
        env.step(68)


def test_an_action_that_is_none_of_the_set_is_refused_and_nothing_moves(corner):
    with made(corner) as env:
        env.unwrapped.reset(seed=1)
        for action in (-1, 81, 1000, 10**5000, 1.5, 1.0, math.nan, "x", None, [1], np.array([1, 2]), np.float64(3.0)):
            with pytest.raises(BadActionError, match="expected an integer from 0 to 80"):
                env.unwrapped.step(action)
        assert env.unwrapped._steps == 0, "the town of a copy would change with them"
        assert env.unwrapped.step(40)[4]["event_step"] == 1
        for action in (np.int64(40), np.array(40), np.array([40])):
            env.unwrapped.step(action)


@pytest.mark.parametrize("seed", [-1, 1.5, "x", math.nan, 10**5000], ids=range(5))
def test_a_seed_that_is_none_is_refused_before_a_world_is_made(corner, seed):
    with made(corner) as env, pytest.raises(ConfigError, match="expected an integer from 0 to"):
        env.reset(seed=seed)
    for face in CLASSES:
        with pytest.raises(ConfigError, match="expected an integer from 0 to"):
            face(str(corner), seed=seed)
    several = StreetVecEnv(str(corner))
    with pytest.raises(ConfigError, match="expected an integer from 0 to"):
        several.seed(seed)
    with pytest.raises(ConfigError, match="expected an integer from 0 to"):
        StreetParallelEnv(str(corner)).reset(seed=seed)


def by_id(**words: Any) -> Env:
    return gymnasium.make(wcsim.ENV_ID, **words)


EACH_FACE = pytest.mark.parametrize("face", [*CLASSES, by_id])


@EACH_FACE
def test_an_argument_that_no_face_takes_is_refused_and_the_nearest_one_named(face):
    with pytest.raises(TypeError, match=r"'overides'; expected .*config, hook, .*; did you mean 'overrides'\?"):
        face(town="nowhere", overides=TINY)
    with pytest.raises(TypeError, match=r"argument 'windows'; expected .*config"):
        face(town="nowhere", windows=2)
    with pytest.raises(TypeError, match=r"argument 'twon'; expected .*town.*; did you mean 'town'\?"):
        face(twon="nowhere")


@EACH_FACE
def test_an_override_by_itself_is_refused_with_how_to_write_it(face):
    with pytest.raises(ConfigError, match=r"expected several: overrides=\['env.window=4'\]"):
        face(town="nowhere", overrides="env.window=4")


@pytest.mark.parametrize("face", [WheelchairEnv, StreetParallelEnv])
def test_the_options_are_named_where_an_editor_shows_them(face):
    told = next(line for line in face.__init__.__doc__.splitlines() if "**options:" in line)
    assert set(EnvOptions.__annotations__) <= set(told.replace(":", ",").replace(" ", "").split(","))


@EACH_FACE
def test_overrides_are_laid_over_a_configuration_too_and_a_preset_beside_one_is_refused(face):
    config = resolve("quick", TINY)
    env = face(config=config, overrides=("env.max_steps=7",))
    found = (env.unwrapped if face is by_id else env).config
    assert found == resolve(config, "env.max_steps=7") != config
    with pytest.raises(ConfigError, match=r"config and preset='laptop': expected one of them"):
        face(config=config, preset="laptop")


@pytest.mark.parametrize("face", CLASSES)
def test_a_film_has_the_pace_of_its_own_tick(face):
    paces = [face("helsinki", overrides=overrides).metadata["render_fps"] for overrides in ([], ["world.tick_s=0.05"])]
    assert paces == [10, 20]


def test_wrong_settings_are_named_before_a_world_is_made():
    for wrong, told in (
        ({"preset": "nope"}, "unknown preset 'nope'; expected one of: best, dqn, laptop, paper, quick"),
        ({"overrides": ("env.colour=1",)}, "unknown key 'env.colour'"),
        ({"overrides": ('env.profile="nobody"',)}, "unknown user profile 'nobody'; expected one of: competent"),
        ({"render_mode": "human"}, "expected 'rgb_array'"),
    ):
        with pytest.raises(ConfigError, match=told):
            WheelchairEnv(**wrong)
    env = gymnasium.make(wcsim.ENV_ID, town="nowhere")
    with pytest.raises(TownError, match="nowhere"):
        env.reset(seed=1)
    env.close()


SAVING = EnvOptions(overrides=("world.warmup_s=2", "env.observation=state"))


@pytest.fixture
def saving(corner: Path) -> Iterator[SavingEnv]:
    made = SavingEnv(str(corner), **SAVING)
    yield made
    made.close()


def driven(env: SavingEnv | WheelchairEnv, actions: Sequence[int]) -> list[tuple[bytes, float]]:
    """What an agent sees and gets for these actions."""
    steps = (env.step(action) for action in actions)
    return [(np.asarray(seen).tobytes(), float(reward)) for seen, reward, *_ in steps]


def test_a_moment_goes_on_as_it_did_and_as_without_moments(saving: SavingEnv, corner: Path) -> None:
    saving.reset(seed=4)
    plain = WheelchairEnv(str(corner), **SAVING)
    plain.reset(seed=4)
    before, after = driven(plain, [1] * 5), driven(plain, [1, 2] * 10)
    plain.close()
    assert driven(saving, [1] * 5) == before
    moment = saving.save()
    other = driven(saving, [3] * 20)
    assert other != after
    for _ in range(2):
        saving.restore(moment)
        assert driven(saving, [1, 2] * 10) == after
    saving.restore(moment)
    assert driven(saving, [3] * 20) == other
    moment.close()


def test_moments_of_moments(saving: SavingEnv) -> None:
    saving.reset(seed=4)
    first = saving.save()
    driven(saving, [1] * 4)
    second = saving.save()
    ahead = driven(saving, [1] * 4)
    saving.restore(first)
    assert driven(saving, [1] * 8)[4:] == ahead
    saving.restore(second)
    assert driven(saving, [1] * 4) == ahead
    first.close()
    with pytest.raises(ProtocolError, match="ended"):
        saving.restore(first)
    second.close()


def test_another_seed_after_a_moment_is_a_world_as_any(saving: SavingEnv) -> None:
    seen, _ = saving.reset(seed=4)
    moment = saving.save()
    saving.reset(seed=5)
    saving.restore(moment)
    driven(saving, [1] * 3)
    again, _ = saving.reset(seed=4)
    assert np.asarray(again).tobytes() == np.asarray(seen).tobytes()
    saving.close()
    saving.restore(moment)  # it outlives its environment
    driven(saving, [1] * 3)
    moment.close()


def test_one_that_saves_is_an_environment_as_any_and_tells_faults(saving: SavingEnv) -> None:
    with pytest.raises(ProtocolError, match="reset"):
        saving.save()
    check_env(saving, skip_render_check=True)
    with pytest.raises(BadActionError):
        saving.step(10_000)
    driven(saving, [1])
