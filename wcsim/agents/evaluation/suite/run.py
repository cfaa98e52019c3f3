"""A suite, driven by several processes.

Each block by itself, in any order, kept as soon as it is done.
"""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from wcsim.agents.evaluation.suite.alarms import Survival
from wcsim.agents.evaluation.suite.drive import LATE_S, Piece, Watch, drive_block, refused
from wcsim.agents.evaluation.suite.records import CRASHED, Records, record_of
from wcsim.agents.evaluation.suite.result_files import TOWNS
from wcsim.agents.opening.list_file import (
    HashedSuite,
    load_suite_towns,
    make_block_setup,
    require_block_towns,
)
from wcsim.agents.opening.named_policy import (
    list_policy_overrides,
    open_named_policy,
    resolve_policy_config,
)
from wcsim.agents.policies.served_policy import ServedPolicyClient
from wcsim.agents.policy_api import UNAIDED, Policy
from wcsim.agents.runs.policy_file import parse_policy_name
from wcsim.agents.runs.run_folder import CONFIG, MANIFEST, PLANT, policy_folder_from_name
from wcsim.agents.runs.transfer import (
    folder_to_input_files,
    require_sendable_run,
    town_to_input_files,
)
from wcsim.config import RunConfig, resolve
from wcsim.config.load import texts_from_override
from wcsim.config.suite import SuiteBlock
from wcsim.core import seeding
from wcsim.core.constants import RECORDED
from wcsim.core.files import sha256_from_file, sha256_from_text, write_json
from wcsim.core.own_folder import create_temporary_folder
from wcsim.core.plugins import find_user_class_files, import_class
from wcsim.core.reading import BLOCK, escape, is_file, read_json
from wcsim.core.sources import hash_package_code, read_package_version
from wcsim.errors import ConfigError, WcsimError
from wcsim.server.workers.machines import (
    HERE,
    ToLocalPath,
    WorkerPoolSettings,
    WorkInputFiles,
    WorkPiece,
)
from wcsim.server.workers.scheduler import WorkerStatus, WorkScheduler
from wcsim.supervisor.actions import action_set
from wcsim.towns.cache.folder import cache_folder, write_verdict

KEPT: Final = "kept"  # a folder of the blocks that are done
_LEAST_LATE_S: Final = 1800.0  # blocks differ by much
_LOOK_S: Final = 1.0

Done = Callable[[str, int, int], object]  # policy, blocks done, blocks in all
Look = Callable[[tuple[WorkerStatus, ...]], object]  # told every second who drives what


@dataclass(frozen=True, slots=True, kw_only=True)
class SuiteOrder:
    """How to drive a suite."""

    suite: HashedSuite
    out: Path
    jobs: int = 1
    machines: WorkerPoolSettings = HERE  # where; `jobs` says how many
    look: Look = lambda now: None
    preset: str = "quick"  # of policies that bring no settings of their own, and the rules for all
    settings: tuple[str, ...] = ()  # over those of the suite: what is changed on purpose
    network: str = ""
    forks: int = 1 << 30  # episodes whose interventions are judged, evenly spread
    late_s: float = LATE_S
    hook: str = ""  # the user's own step hook, module:Class
    together: tuple[str, ...] = ()  # policies that take turns in the seats of each block
    # Blocks of the user alone are read from the cache, and saved there for other tests.
    shared: bool = False
    overrules: bool = False  # users take over for 20 s after two needless interventions


def run_suite(
    order: SuiteOrder, policies: Sequence[str], done: Done, blocks: Sequence[int] = ()
) -> dict[str, Records]:
    """Drive all episodes, or those of some blocks; records by policy, in the order of the list.

    What is kept in `order.out` from before is not driven again. KeyboardInterrupt leaves what is
    done there.

    Raises:
        ConfigError: The list cannot be used, or a kept result is broken.
        TownError: A town is missing or another one than the list's.
        PolicyError: There is no such policy.
        WorkersError: Processes or machines died too often, or there are none left.
    """
    file = order.suite.file
    require_block_towns(file)
    towns = town_addresses(order)
    judged = _judged_blocks(file.blocks, order.forks)
    chosen = sorted(blocks) or range(len(file.blocks))
    saved: dict[tuple[str, int], Records] = {}
    left: list[tuple[Piece, tuple[Path, ...]]] = []
    chairs = {name: order.together if name in order.together else (name,) for name in policies}
    digests = {names[0]: _policy_digest(names[0], order) for names in chairs.values()}
    for policy, digest in digests.items():
        for index in chosen:
            # By what its result depends on: its list, its place in it, and the policy's digest.
            key = sha256_from_text(json.dumps([file.suite, order.suite.sha256, index, digest]))
            path, cached = (
                order.out / KEPT / f"{key}.json",
                cache_folder() / f"rows-{key[:32]}.json",
            )
            if path.is_file():
                saved[policy, index] = _read_saved(path)
                continue
            # The user alone drives beside every policy. Where his rows are damaged he drives again.
            places = (path, cached) if order.shared and policy == UNAIDED else (path,)
            with suppress(ConfigError):
                if places[-1].is_file():
                    saved[policy, index] = _read_saved(cached)
                    done(policy, sum(name == policy for name, _ in saved), len(chosen))
                    continue
            left.append((piece_of(order, index, policy, towns, judged=index in judged), places))
    _drive_all(order, left, saved, done, len(chosen))
    return {
        policy: tuple(
            record
            for index in chosen
            for record in saved[names[0], index]
            if names[(record.block + record.seat) % len(names)] == policy
        )
        for policy, names in chairs.items()
    }


def require_usable(order: SuiteOrder, policies: Iterable[str]) -> None:
    """Open each policy once, as every block does.

    What can be used in none is known before anything is driven.

    Raises:
        PolicyError: There is no such policy, it cannot be built, or it does not fit the list.
        ConfigError: The settings cannot be used.
    """
    for name in policies:
        config = resolve_policy_config(
            name, order.preset, (*order.suite.file.settings, *order.settings), in_list=True
        )
        with ExitStack() as opened:
            resolve(
                config,
                list_policy_overrides(config, _open_in(opened, name, config, 0, order.network)),
            )


def _open_in(opened: ExitStack, name: str, config: RunConfig, seed: int, network: str) -> Policy:
    """A policy that is closed with the stack, if it has something to close.

    Raises as `open_named_policy` does.
    """
    policy = open_named_policy(name, config, seed, network or None)
    if hasattr(policy, "close"):
        opened.callback(policy.close)
    return policy


def town_addresses(order: SuiteOrder) -> dict[str, str]:
    """Where the list's towns are, by name. Raises TownError, see `load_suite_towns`."""
    return {
        name: town.address
        for name, town in load_suite_towns(order.suite.file, order.out / TOWNS).items()
    }


def piece_of(
    order: SuiteOrder, index: int, policy: str, towns: Mapping[str, str], judged: bool
) -> Piece:
    """One block with one policy; `towns` as in `town_addresses`."""
    file = order.suite.file
    block = file.blocks[index]
    return Piece(
        index=index,
        block=block,
        town=towns.get(block.town, ""),
        settings=(*file.settings, *order.settings),
        policy=policy,
        together=order.together if policy in order.together else (),
        network=order.network,
        preset=order.preset,
        judged=judged,
        late_s=order.late_s,
        hook=order.hook,
        overrules=order.overrules,
    )


def _drive_all(
    order: SuiteOrder,
    left: Iterable[tuple[Piece, tuple[Path, ...]]],
    saved: dict[tuple[str, int], Records],
    done: Done,
    blocks: int,
) -> None:
    ordered = {_work_key(piece): (piece, places) for piece, places in left}
    if not ordered:
        return

    def save(key: str, data: bytes) -> None:
        path, *cached = ordered[key][1]
        write_json(path, {"records": json.loads(data)})
        for place in cached:
            write_verdict(place, path.read_bytes())

    # The longest first: a block of many episodes at the end would leave all other processes
    # without work.
    pieces = sorted(
        (piece for piece, _ in ordered.values()), key=lambda piece: -len(piece.block.episodes)
    )
    waiting = set(ordered)
    machines = replace(order.machines, count=order.jobs)
    if machines.cluster:
        policies = {piece.policy for piece in pieces}
        for policy in sorted(policies):
            if parse_policy_name(policy).kind == "served":
                message = (
                    "is a process of this machine; test other policies, or use --jobs without "
                    "--cluster"
                )
                raise ConfigError(f"--cluster: {policy} {message}")
        own = [policy for policy in policies if parse_policy_name(policy).kind == "class"]
        require_sendable_run(
            RunConfig(), _all_settings(order), (*own, order.network, order.hook), _users(order)
        )
    with WorkScheduler(machines.open(order.out), save, least_late_s=_LEAST_LATE_S) as scheduler:
        scheduler.submit(
            [
                WorkPiece(key=_work_key(piece), call=_drive_alone, piece=piece, needs=_needs_of)
                for piece in pieces
            ]
        )
        while waiting:
            for key in sorted(scheduler.wait(waiting, _LOOK_S)):
                waiting.remove(key)
                piece, (path, *_) = ordered[key]
                saved[piece.policy, piece.index] = _read_saved(path)
                done(piece.policy, sum(name == piece.policy for name, _ in saved), blocks)
            order.look(scheduler.workers_now())


def _work_key(piece: Piece) -> str:
    """What a piece is called wherever something is said of it."""
    return f"{piece.policy}/{piece.index}"


def _needs_of(piece: Piece) -> tuple[WorkInputFiles, ...]:
    """What travels with a piece.

    Its town, unless it is a generated scene, and its policy, unless it is a baseline.
    """
    towns = (town_to_input_files(piece.town),) if piece.block.scene_sha256 is None else ()
    named = parse_policy_name(piece.policy)
    if named.kind == "baseline":
        return towns
    if named.kind == "onnx":
        return (*towns, folder_to_input_files(named.folder, named.place))
    # A policy by its name without a level, with what its run says of it.
    policy = policy_folder_from_name(named.place).resolve()
    alone, run = folder_to_input_files(policy, named.place), policy.parent.parent
    if not is_file(run / MANIFEST):
        return (*towns, alone)
    identity = [file for file in (MANIFEST, CONFIG, PLANT) if is_file(run / file)]
    inner = policy.relative_to(run).as_posix()
    names = (*identity, *(f"{inner}/{file}" for file in alone.names))
    return (*towns, replace(alone, folder=run, names=names, inner=inner))


def _policy_at(name: str, at: ToLocalPath) -> str:
    """A policy's name, veto and level included, where it lies now."""
    place = parse_policy_name(name).place
    before, _, after = name.partition(place)
    return before + at(place) + after


def _drive_alone(piece: Piece, at: ToLocalPath) -> bytes:
    """Drive one block in this process, wherever that is; its records as JSON."""
    is_baseline = parse_policy_name(piece.policy).kind == "baseline"
    policy = piece.policy if is_baseline else _policy_at(piece.policy, at)
    records = [
        record.to_json()
        for record in drive_piece(replace(piece, town=at(piece.town), policy=policy))
    ]
    for record in records:
        # it may name the policy
        record["reason"] = str(record["reason"]).replace(policy, piece.policy)
    return json.dumps(records).encode()


def drive_piece(piece: Piece, watch: Watch | None = None) -> Records:
    """Drive one block in this process.

    A policy that cannot be used there is refused, not an error.
    """
    from wcsim.towns.scenario.town import find_town

    config = resolve_policy_config(piece.policy, piece.preset, piece.settings, in_list=True)
    seats, names = range(len(piece.block.episodes)), piece.together or (piece.policy,)
    seeds = (seeding.derive_seed(piece.block.seed, "driver", seat) for seat in seats)
    with ExitStack() as opened, create_temporary_folder() as work:
        try:
            for name in names:  # the street has the senses, and the longest window, of all
                config = resolve(
                    config,
                    list_policy_overrides(config, _open_in(opened, name, config, 0, piece.network)),
                )
            drivers = [
                _open_in(
                    opened, names[(piece.index + seat) % len(names)], config, seed, piece.network
                )
                for seat, seed in enumerate(seeds)
            ]
        except WcsimError as error:
            return refused(piece, str(error))
        place = make_block_setup(piece.block, config, lambda: find_town(piece.town), work)
        records = drive_block(piece, place, iter(drivers).__next__, watch)
    crashed = {record.seat: record for record in records if record.status == CRASHED}
    if watch is not None or not piece.judged or not crashed:
        return records
    # Once more up to the crashes: could they still have been survived, and why were they not?
    handovers = {seat: episode.handover_step for seat, episode in enumerate(piece.block.episodes)}
    survival = Survival(crashed, handovers, config.world.tick_s)
    drive_piece(replace(piece, judged=False), survival)
    return tuple(survival.records.get(each.seat, each) for each in records)


def _policy_digest(name: str, order: SuiteOrder) -> str:
    """What a policy's result depends on besides the list.

    Its weights or name, the settings, all code and files.
    """
    named = _own_files(_all_settings(order), order.network, _users(order))
    hooks = find_user_class_files(order.hook, "step hook") if order.hook else {}
    own = {word: sha256_from_file(path) for word, path in (named | hooks).items()}
    simulators = [read_package_version(name) for name in ("libsumo", "pybullet", "numpy")]
    identity = [
        order.settings,
        order.forks,
        order.overrules,
        order.network,
        order.hook,
        own,
        hash_package_code(),
        simulators,
    ]
    identity += _identity_of(name, order.preset)
    identity += [
        _identity_of(other, order.preset) for other in order.together if name in order.together
    ]
    return sha256_from_text(json.dumps(identity))


def _identity_of(name: str, preset: str) -> list[Any]:
    """What tells a policy from another one of the same name, as plain data.

    Its weights, its file, what it says.
    """
    named = parse_policy_name(name)
    if named.veto:
        return ["veto", *_identity_of(named.inner, preset)]
    if named.kind == "baseline":
        return ["baseline", name, preset]
    if named.kind == "served":
        with closing(
            ServedPolicyClient(name, action_set(resolve(preset).env.actions).points)
        ) as served:
            return ["served", served.version, preset]
    if named.kind == "onnx":
        return ["onnx", preset, _hashes(Path(name))]
    if named.kind == "class":
        # With the files that the class names in `files`, as far as they are there.
        listed = getattr(import_class(name, "policy"), "files", ())
        words = (
            (word for word in listed if isinstance(word, str))
            if isinstance(listed, tuple | list)
            else ()
        )
        read = find_user_class_files(name, "policy") | {
            word: Path(word) for word in words if is_file(Path(word))
        }
        return [
            "class",
            name,
            preset,
            {part: sha256_from_file(path) for part, path in read.items()},
        ]
    law = ["exported law"] if find_spec("torch") is None else []  # see `open_named_policy`
    return [
        "folder",
        preset,
        _hashes(policy_folder_from_name(name), "**/*"),
        *law,
        *([] if named.level is None else [named.level]),
    ]


def _own_files(settings: Iterable[str], network: str, users: Iterable[str]) -> dict[str, Path]:
    """The user's own files that settings, a network's name and users lead to.

    By the word, or the file's name.

    >>> _own_files(("world.action_delay_ticks=2",), "fig6", ("ataxic",))
    {}
    """
    texts = [text for setting in settings for text in texts_from_override(setting)]
    # as of collect.variants
    inner = (word.partition("=")[2].strip("'\"") for text in texts for word in text.split())
    paths = {value: Path(value.removeprefix(RECORDED)) for value in (*texts, *inner, *users)}
    found = {value: path for value, path in paths.items() if is_file(path)}
    return {**found, **find_user_class_files(network, "network")} if ":" in network else found


def _hashes(folder: Path, pattern: str = "*") -> list[list[str]]:
    """What a policy consists of.

    One of values on top of dangers has these in a folder of its own below.
    """
    found = (path for path in sorted(folder.glob(pattern)) if path.is_file())
    return [[path.relative_to(folder).as_posix(), sha256_from_file(path)] for path in found]


def _all_settings(order: SuiteOrder) -> list[str]:
    """What is set in the list, in any of its blocks, and over them."""
    file = order.suite.file
    return [
        *file.settings,
        *(text for block in file.blocks for text in block.settings),
        *order.settings,
    ]


def _users(order: SuiteOrder) -> list[str]:
    """The users of a list; those of a scene lie in it."""
    blocks = (block for block in order.suite.file.blocks if block.scene_sha256 is None)
    return sorted({episode.profile for block in blocks for episode in block.episodes})


def _judged_blocks(blocks: Sequence[SuiteBlock], episodes: int) -> frozenset[int]:
    """The blocks whose interventions are judged.

    Evenly spread, as many as hold so many episodes.
    """
    total = sum(len(block.episodes) for block in blocks)
    if episodes >= total:
        return frozenset(range(len(blocks)))
    if episodes <= 0:
        return frozenset()
    count = max(1, round(len(blocks) * episodes / total))
    return frozenset((number * len(blocks)) // count for number in range(count))


def _read_saved(path: Path) -> Records:
    """The records of a block that was driven before. Raises ConfigError."""
    data = read_json(path, BLOCK)
    try:
        return tuple(record_of(record) for record in data["records"])
    except (ConfigError, KeyError, TypeError, ValueError) as error:
        raise ConfigError(f"{escape(path)}: is damaged ({error}); expected {BLOCK.what}") from None
