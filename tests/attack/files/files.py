"""Hostile files of every kind that a person may get from another: settings, plants, towns, runs and recordings."""

import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from tests.attack.files.damage import swollen
from tests.attack.files.family import Family, Take, Twist, modelled
from tests.attack.outcomes import Case
from tests.attack.scenarios.twists import (
    NASTY,
    Rng,
    draws,
    integer,
    json_text,
    pick,
    places,
    spoiled,
    toml_value,
    twisted,
    without_none,
)
from tests.support.framing import chained, write_log
from wcsim.agents.envs.env_spec import make_env_settings
from wcsim.agents.runs.run_folder import (
    CONFIG,
    MANIFEST,
    make_run_manifest,
    open_run,
    read_run_json,
    run_manifest_from_json,
)
from wcsim.config import Model, RunConfig, TownFile, parse_json, read_toml, resolve
from wcsim.config.plant import read_own_plant_bytes, read_plant
from wcsim.config.scene import SceneFile
from wcsim.log.framing import frame_payload, iter_whole_records
from wcsim.log.reader import read_trace_states
from wcsim.log.records import ActorBody, Header, WorldState, record_to_bytes
from wcsim.physics.wheelchair.plant import plant_spec
from wcsim.server.specs import RunInfo
from wcsim.towns.scenario.overrides import Override
from wcsim.types import ActorKind
from wcsim.users.recordings.recorded_user import COLUMNS, find_user, read_stick_recording

RICH = (
    *("cameras.0.noise=typical", 'vary.plant={"wheel.friction" = [0.5, 0.9]}'),
    *("vary.light=[0.5, 1.5]", "env.window=4"),
)


def same(model: Model) -> bool:
    """Whether a model, written as wcsim writes it, is read as an equal one."""
    return parse_json(type(model), model.model_dump_json(), "again") == model


def take_config(config: RunConfig) -> bool:
    """A configuration, with all that the faces do with one before there is a world."""
    make_env_settings("nowhere", {"config": config}).observation_space()
    plant_spec(config.chair)
    return same(config)


def _take_plant(path: Path) -> bool:
    read_own_plant_bytes(str(path))
    return same(read_plant(str(path)))


def _take_manifest(path: Path) -> bool:
    data = read_run_json(path.parent, MANIFEST)
    clients = data.pop("clients", [])
    manifest = run_manifest_from_json(data, path.parent)
    plain = all(Path(name).name == name for name in clients)
    return plain and run_manifest_from_json(json.loads(json.dumps(data)), path.parent) == manifest


def _take_recording(path: Path) -> bool:
    recording = read_stick_recording(path)
    rows = np.c_[recording.time_s, recording.sticks].tolist()
    path.write_text("\n".join([",".join(COLUMNS), *(",".join(map(repr, row)) for row in rows)]), encoding="utf-8")
    again = read_stick_recording(path)
    return np.array_equal(recording.time_s, again.time_s) and np.allclose(recording.sticks, again.sticks, atol=1e-12)


def _take_trace(path: Path) -> bool:
    header, ticks = read_trace_states(path)
    path.unlink()
    found, again = read_trace_states(write_log(path, header, ticks))
    return found == header and [*map(record_to_bytes, ticks)] == [*map(record_to_bytes, again)]


# --- sound ones ---


def csv_twist(rows: list[list[Any]]) -> Twist:
    def twist(rng: Rng) -> tuple[bytes, str]:
        table = [list(row) for row in rows]
        line, number = integer(rng, len(table)), integer(rng, len(NASTY))
        row = table[line]
        row[integer(rng, len(row))] = NASTY[number]
        out = io.StringIO()
        csv.writer(out).writerows(table)
        return out.getvalue().encode("utf-8"), f"line {line} = nasty {number}"

    return twist


def log_twist(sound: bytes) -> Twist:
    """A field of the header or of a record, or its numbers, with lengths and checksums made to fit."""
    records = list(iter_whole_records(io.BytesIO(sound)))
    payloads, last = [record.payload for record in records], records[-1].crc

    def twist(rng: Rng) -> tuple[bytes, str]:
        if integer(rng, 5) == 0:
            return swollen(sound, rng, lambda payload: frame_payload(payload, last)), "swollen"
        at, how = integer(rng, len(payloads)), integer(rng, 4)
        if not at:
            data, told = twisted(json.loads(payloads[0]), rng)
            payload = json_text(data).encode()
        elif how == 0:
            payload, told = spoiled(payloads[at], rng)
        else:
            fields = msgspec.msgpack.decode(payloads[at])
            fields, told = (_odd_number(fields, rng), "an odd number") if how == 1 else twisted(fields, rng)
            payload = _packed(fields)
        return chained([*payloads[:at], payload, *payloads[at + 1 :]]), f"record {at}: {told}"

    return twist


def logged(name: str, file: str, sound: bytes, take: Take) -> Family:
    """A kind of file that is a journal."""
    return Family(name=name, file=file, sound=sound, twist=log_twist(sound), take=take)


def _packed(fields: Any) -> bytes:
    """Fields as a record; a byte that is never one where MessagePack cannot hold an integer."""
    try:
        return msgspec.msgpack.encode(fields, enc_hook=str)
    except (OverflowError, RecursionError):
        return b"\xc1"


def _odd_number(fields: Any, rng: Rng) -> Any:
    """Another number in an array, or in place of a number."""
    odd = pick(rng, (np.nan, np.inf, -np.inf, 1e308, -1e300, 5e-324, 0.0))
    arrays = [field for field in fields if isinstance(field, list) and len(field) == 3 and isinstance(field[2], bytes)]
    if not arrays:
        return [odd if isinstance(field, float) else field for field in fields]
    array = pick(rng, tuple(arrays))
    numbers = np.frombuffer(array[2], f"<f{array[1]}").copy()
    if len(numbers):
        numbers[integer(rng, len(numbers))] = odd
    array[2] = numbers.tobytes()
    return fields


def sound_trace(work: Path) -> bytes:
    rng = np.random.default_rng(0)
    bodies = (
        ActorBody(id="v:a", kind=ActorKind.CAR, size_lwh_m=(4.5, 1.8, 1.5)),
        ActorBody(id="p:b", kind=ActorKind.PEDESTRIAN, size_lwh_m=(0.4, 0.6, 1.7), piece=1),
    )
    ticks = [
        WorldState(
            epoch=0, tick=tick, commands=rng.random((2, 2)), plants=rng.random((2, 15)), actor_ids=("v:a", "p:b"),
            actors=rng.random((2, 8)), state_hash="ab" * 8, time_s=0.1 * (tick + 1), bodies=bodies, seats=(0, 3),
        )
        for tick in range(3)
    ]  # fmt: skip
    header = Header(town="t", seed=1, tick_s=0.1, seats=2, fingerprint="a", chair_box_m=(1.1, 0.3))
    path = write_log(work / "sound.trace", header, ticks)
    data = path.read_bytes()
    path.unlink()
    return data


def _sound_manifest(config: RunConfig) -> dict[str, Any]:
    override = Override(option="--step-length", author="1", wcsim="0.1", why="ticks")
    words = ("wcsim", "train")
    info = RunInfo(
        seed=3, town="helsinki", town_sha256="ab" * 32, rewards=("own:Term",), command=words, hook="own:Hook",
        overrides=(override,),
    )  # fmt: skip
    manifest = make_run_manifest(config, info)
    names = ("seed", "town", "town_sha256", "config_sha256", "rewards", "command", "versions", "git_revision", "steps")
    data = {name: getattr(manifest, name) for name in (*names, "status", "hook")}
    rows = [{"option": "--step-length", "author": "1", "wcsim": "0.1", "why": "ticks"}]
    return json.loads(json.dumps({**data, "overrides": rows, "clients": ["patch", "fig6-2"]}))


def families(work: Path) -> list[Family]:
    """All kinds of files."""
    config = resolve("quick", RICH)
    whole = config.model_dump(mode="json")
    plant, manifest = read_plant("rwd").model_dump(mode="json"), _sound_manifest(config)
    town = {"name": "a", "split": "test", "origin_m": [4, 5], "warmup_s": 3.0, "sumocfg": "a.sumocfg", "source": "me",
            "attribution": "(c) me", "rebuild": "make", "hashes": {"a": "ab" * 32}, "kerb_height_m": 0.12,
            "lowered_kerb_m": 0.0, "chair_ways": ["sidewalk", "shared"]}  # fmt: skip
    seats = [{"start_m": [1.0, 2.0], "heading_deg": 90.0, "goal_m": [9.0, 2.0], "profile": "competent"},
             {"start_m": [1.0, 2.0], "heading_deg": 0.0, "script": [[0.0, 0.1, 0.2], [1.0, 0.0, 0.0]]}]  # fmt: skip
    scene = {"name": "a", "shows": "a street", "seed": 3, "duration_s": 9.0, "seats": seats,
             "expect": {"crashed": False, "climb_m": [0.1, 0.2]}, "warmup_s": 1.0, "lefthand": False}  # fmt: skip
    sticks = [list(COLUMNS), *([0.1 * row, 0.01 * row, 0.5] for row in range(12))]
    stick_text = "\n".join(",".join(map(str, row)) for row in sticks).encode()
    lone = {key: value for key, value in manifest.items() if key != "clients"}
    return [
        modelled("config", "c.toml", without_none(whole), lambda path: take_config(resolve("quick", path))),
        modelled("plant", "p.toml", without_none(plant), _take_plant),
        modelled("scene", "scene.toml", scene, lambda path: same(read_toml(path, SceneFile))),
        modelled("town", "town.toml", town, lambda path: same(read_toml(path, TownFile))),
        modelled("manifest", MANIFEST, manifest, _take_manifest, json_text),
        modelled(
            *("run", CONFIG, whole, lambda path: same(open_run(path.parent).config), json_text),
            beside=((MANIFEST, json_text(lone).encode()),),
        ),
        Family(name="recording", file="s.csv", sound=stick_text, twist=csv_twist(sticks), take=_take_recording),
        logged("trace", "trace", sound_trace(work), _take_trace),
    ]


# --- words of a command ---


def set_cases(count: int, seed: int, work: Path) -> Iterator[Case]:
    """So many values after `--set`."""
    del work
    config = resolve("quick")
    keys = [".".join(map(str, at)) for at in places(config.model_dump(mode="json"))]
    for number, rng in draws(count, seed):
        yield _set_case(config, keys, rng, number)


def _set_case(config: RunConfig, keys: list[str], rng: Rng, number: int) -> Case:
    key, value = pick(rng, keys), pick(rng, NASTY)
    odd = ("", ".", "a." * 2000 + "b", "world..tick_s", "\0", "cameras.99.name", "cameras.-1.name", "=", "world", "é")
    text = f"{pick(rng, odd) if integer(rng, 10) == 0 else key}={value if integer(rng, 3) == 0 else toml_value(value)}"

    def feed() -> bool:
        made = resolve(config, text)
        find_user(made.env.profile)
        return take_config(made) and resolve("quick", text).digest() != ""

    return Case(area="set", name=f"{number}: {text[:80]!r}", feed=feed)
