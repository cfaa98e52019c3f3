"""How a policy is named: `follow`, `dwa@0.5`, `runs/a:phase1`, `veto:shipped@0.2`, `mine:Policy`, `tcp:5000`.

`policy_name` reads such a name in one place, before anything of the policy is loaded.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

from wcsim.agents.policy_api import BASELINES, LEVELLED, MODEL_FILE, SERVED, UPPER_BOUNDS, VETO, level_of
from wcsim.agents.runs.policy_file import SHIPPED
from wcsim.core.reading import escaped, is_file, is_folder
from wcsim.errors import PolicyError

STAGES: Final = ("phase1", "final")
_LEVEL: Final = re.compile(r"\d+(\.\d*)?|\.\d+")
Kind = Literal["baseline", "served", "onnx", "class", "shipped", "folder"]


@dataclass(frozen=True, slots=True, kw_only=True)
class PolicyName:
    """The parts of a policy's name."""

    inner: str  # the name without a veto
    veto: bool
    kind: Kind
    place: str  # the name without veto and level: RUN:stage, FOLDER, module:Class, an address, or a word
    stage: str = ""  # of RUN:stage
    level: float | None = None  # of assistance, or the threshold of dangers

    @property
    def folder(self) -> Path:
        """Where a run, a policy folder or an ONNX folder lies."""
        return Path(self.place.removesuffix(f":{self.stage}") if self.stage else self.place)

    @property
    def is_network(self) -> bool:
        """Whether it is a network that wcsim trained, in a run, a folder of its own, or shipped."""
        return self.kind in ("shipped", "folder")


def policy_name(text: str) -> PolicyName:
    """The parts of a policy's name; whether there is such a policy is not asked.

    >>> policy_name("veto:dwa@0.5").kind, policy_name("runs/a:phase1@0.2").stage, policy_name("mine:Policy").kind
    ('baseline', 'phase1', 'class')

    Raises:
        PolicyError: It ends with a level that there is not.
    """
    veto, name = text.startswith(VETO), text.removeprefix(VETO)
    word = name.partition("@")[0]
    if word == LEVELLED or name in (*BASELINES, *UPPER_BOUNDS):
        return PolicyName(inner=name, veto=veto, kind="baseline", place=word, level=level_of(name))
    if name.startswith(SERVED):
        return PolicyName(inner=name, veto=veto, kind="served", place=name)
    if name != SHIPPED and is_file(Path(name) / MODEL_FILE):
        return PolicyName(inner=name, veto=veto, kind="onnx", place=name)
    place, level = _with_threshold(name)
    run, colon, stage = place.rpartition(":")
    if colon and stage not in STAGES and not is_folder(Path(run)):
        return PolicyName(inner=name, veto=veto, kind="class", place=name)
    kind: Kind = "shipped" if place == SHIPPED else "folder"
    stage = stage if colon and not is_folder(Path(place)) else ""
    return PolicyName(inner=name, veto=veto, kind=kind, place=place, stage=stage, level=level)


def _with_threshold(name: str) -> tuple[str, float | None]:
    """A name without the threshold that it may end with, and that threshold; `b@home` has none."""
    head, at, text = name.rpartition("@")
    if not at or not _LEVEL.fullmatch(text):
        return name, None
    level = float(text)
    if not 0.0 < level <= 1.0:
        raise PolicyError(
            f"policy {escaped(name)!r} has no such level of assistance; expected RUN@L with a danger threshold L "
            "above 0 and at most 1"
        )
    return head, level
