"""A suite, driven by several processes: each block by itself, in any order, kept as soon as it is done."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from wcsim.agents.evaluation.senses import senses_of, with_senses
from wcsim.agents.evaluation.suite.drive import BlockOrder, drive_block, refused
from wcsim.agents.evaluation.suite.list_file import TIGHT, Suite, block_key, require_towns, towns_of
from wcsim.agents.evaluation.suite.records import EpisodeRecord, record_of
from wcsim.agents.evaluation.suite.tight import in_scene, open_tight
from wcsim.agents.policies.baseline_names import is_baseline
from wcsim.agents.policy_api import Policy
from wcsim.agents.runs.run_folder import config_of, policy_path
from wcsim.config import RunConfig, with_overrides
from wcsim.config.suite import BlockFile
from wcsim.core import seeding
from wcsim.core.files import write_json
from wcsim.core.plugins import find_class
from wcsim.core.reading import FileKind, read_json
from wcsim.errors import ConfigError, WcsimError
from wcsim.supervisor.actions import action_set

UNAIDED: Final = "follow"  # the user alone, on the grid of actions
_KEPT: Final = FileKind(what="a kept result of `wcsim test`: remove it", limit_bytes=64 << 20, error=ConfigError)

Done = Callable[[str, int, int], object]  # policy, blocks done, blocks in all


@dataclass(frozen=True, slots=True, kw_only=True)
class NamedPolicy:
    """A policy as somebody names it, and what its result depends on."""

    name: str
    digest: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Piece:
    """What a process drives: one block with one policy; everything in it can be sent."""

    index: int
    block: BlockFile
    town: str  # a folder or a name
    settings: tuple[str, ...]
    policy: str
    network: str
    preset: str
    judged: bool
    late_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SuiteOrder:
    """How to drive a suite."""

    suite: Suite
    out: Path
    jobs: int = 1
    preset: str = "quick"  # of policies that bring no settings of their own
    settings: tuple[str, ...] = ()  # over those of the suite: what is changed on purpose
    network: str = ""
    forks: int = 1 << 30  # episodes whose interventions are judged, evenly spread
    late_s: float = 10.0


def run_suite(order: SuiteOrder, policies: Sequence[str], done: Done) -> dict[str, tuple[EpisodeRecord, ...]]:
    """Drive all episodes with each policy; records by policy, in the order of the list.

    What is kept in `order.out` from before is not driven again. KeyboardInterrupt leaves what is done there.

    Raises:
        ConfigError: The list cannot be used, or a kept result is broken.
        TownError: A town is missing or another one than the list's.
        PolicyError: There is no such policy.
    """
    file = order.suite.file
    require_towns(file)
    towns = {name: town.address for name, town in towns_of(file).items()}
    judged = _judged(file.blocks, order.forks)
    kept: dict[tuple[str, int], tuple[EpisodeRecord, ...]] = {}
    left: list[tuple[Piece, Path]] = []
    asked = [NamedPolicy(name=name, digest=policy_digest(name, order)) for name in policies]
    for policy in asked:
        for index, block in enumerate(file.blocks):
            path = _kept_path(order, index, policy.digest)
            if path.is_file():
                kept[policy.name, index] = _read_kept(path)
            else:
                piece = Piece(
                    index=index,
                    block=block,
                    town=str(towns.get(block.town, "")),
                    settings=(*file.settings, *order.settings),
                    policy=policy.name,
                    network=order.network,
                    preset=order.preset,
                    judged=index in judged,
                    late_s=order.late_s,
                )
                left.append((piece, path))
    _drive_all(order, left, kept, done, len(file.blocks))
    return {
        policy.name: tuple(record for index in range(len(file.blocks)) for record in kept[policy.name, index])
        for policy in asked
    }


def _drive_all(
    order: SuiteOrder,
    left: Iterable[tuple[Piece, Path]],
    kept: dict[tuple[str, int], tuple[EpisodeRecord, ...]],
    done: Done,
    blocks: int,
) -> None:
    waiting: dict[Future[list[dict[str, Any]]], tuple[Piece, Path]] = {}
    with ProcessPoolExecutor(order.jobs, mp_context=get_context("spawn")) as pool:
        try:
            for piece, path in left:
                waiting[pool.submit(drive_piece, piece)] = piece, path
            while waiting:
                ended, _ = wait(waiting, return_when=FIRST_COMPLETED)
                for future in ended:
                    piece, path = waiting.pop(future)
                    records = future.result()
                    write_json(path, {"records": records})
                    kept[piece.policy, piece.index] = tuple(record_of(record) for record in records)
                    done(piece.policy, sum(name == piece.policy for name, _ in kept), blocks)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def drive_piece(piece: Piece) -> list[dict[str, Any]]:
    """Drive one block in this process; a policy that cannot be used there is refused, not an error."""
    from wcsim.towns.scenario.town import find_town

    config = _config(piece.policy, piece.preset, piece.settings)
    made = iter(range(len(piece.block.episodes)))

    def make_policy() -> Policy:
        return _opened(piece, config, seeding.derive(piece.block.seed, "driver", next(made)))

    try:
        config = _sensing(config, _opened(piece, config, 0))
    except WcsimError as error:
        return [record.to_json() for record in refused(piece.index, piece.block, str(error))]
    with TemporaryDirectory(prefix="wcsim-suite-") as work:
        order = BlockOrder(
            index=piece.index,
            block=piece.block,
            town=find_town(piece.town) if piece.block.part != TIGHT else open_tight(piece.block, Path(work)),
            config=config,
            judged=piece.judged,
            late_s=piece.late_s,
        )
        if piece.block.part == TIGHT:
            order = in_scene(order, Path(work))
        return [record.to_json() for record in drive_block(order, make_policy)]


def policy_digest(name: str, order: SuiteOrder) -> str:
    """What a policy's result depends on besides the list: its weights or name, the settings, wcsim's own code."""
    said: list[Any] = [order.settings, order.forks, _code_digest()]
    if is_baseline(name):
        said += ["baseline", name, order.preset]
    elif ":" in name and not Path(name.rpartition(":")[0]).exists():
        said += ["class", name, order.preset, _file_digest(Path(str(_source_of(name))))]
    else:
        folder = policy_path(name)
        said += ["folder", [[path.name, _file_digest(path)] for path in sorted(folder.iterdir()) if path.is_file()]]
    return hashlib.sha256(json.dumps(said).encode()).hexdigest()


def _opened(piece: Piece, config: RunConfig, seed: int) -> Policy:
    """The policy of a piece. Raises PolicyError when it does not fit."""
    name = piece.policy
    if ":" in name and not is_baseline(name) and not Path(name.rpartition(":")[0]).exists():
        policy: Policy = find_class(name, "policy")(config)
        return policy
    from wcsim.agents.evaluation.matrix import open_policy  # torch is loaded here

    return open_policy(name, config, seed, piece.network or None)


def _sensing(config: RunConfig, policy: Policy) -> RunConfig:
    """The configuration with as many images in an observation as the policy was trained on, and the senses it wants."""
    from wcsim.agents.evaluation.matrix import window_for

    return with_senses(with_overrides(config, (f"env.window={window_for([policy])}",)), senses_of(policy))


def _source_of(name: str) -> str:
    import inspect

    return inspect.getsourcefile(find_class(name, "policy")) or ""


def _config(policy: str, preset: str, settings: tuple[str, ...]) -> RunConfig:
    """A policy's own settings, or the preset, with those of the suite laid over them."""
    from wcsim.config import load_run_config

    own_class = ":" in policy and not Path(policy.rpartition(":")[0]).exists()
    base = load_run_config(preset) if is_baseline(policy) or own_class else config_of(policy, preset, ())
    config = with_overrides(base, settings)
    action_set(config.env.actions)
    return config


def _judged(blocks: Sequence[BlockFile], episodes: int) -> frozenset[int]:
    """The blocks whose interventions are judged: evenly spread, as many as hold so many episodes."""
    total = sum(len(block.episodes) for block in blocks)
    if episodes >= total:
        return frozenset(range(len(blocks)))
    wanted = max(1, round(len(blocks) * episodes / total))
    return frozenset((number * len(blocks)) // wanted for number in range(wanted))


def _kept_path(order: SuiteOrder, index: int, digest: str) -> Path:
    return order.out / "kept" / f"{block_key(order.suite, index, digest)}.json"


def _read_kept(path: Path) -> tuple[EpisodeRecord, ...]:
    data = read_json(path, _KEPT)
    return tuple(record_of(record) for record in data["records"])


def _file_digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _code_digest() -> str:
    """Of every file of the package that a drive may run."""
    root = Path(__file__).parents[3]
    text = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        text.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return text.hexdigest()
