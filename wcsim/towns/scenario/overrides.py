"""What wcsim overrides of a scenario's own options; `tools/overrides_page.py` prints the rules."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from wcsim.config import WorldConfig
from wcsim.config.world import JUPEDSIM
from wcsim.core.reading import read_module_toml
from wcsim.towns.scenario.options import Configuration, Treatment, sumo_options
from wcsim.towns.sumo.xml_io import is_true

STEP, _ACTION_STEP = "step-length", "default.action-step-length"
NET = "net-file"
PEOPLE = "pedestrian.model"
JUMPING = "nonInteracting"
"""Of the models of pedestrians, the one whose people have no way between two streets."""
AGGREGATED = "elechybrid-output.aggregated"
_DATA = read_module_toml(__file__)
_FASTER = (
    "; traffic that was calibrated for longer steps drives 10 to 20 % faster; to correct it, set "
    "world.action_step_s to 0.5 to 0.7 of the scenario's step"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Override:
    """One option of a scenario that a world runs with another value than its author's."""

    option: str
    author: str  # "" where the author says nothing
    wcsim: str
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """What a world decides about a scenario."""

    world: WorldConfig = field(default_factory=WorldConfig)
    seed: int  # SUMO's own


class _Rule(NamedTuple):
    """What happens to an option, in words for the guide."""

    option: str
    effect: str
    why: str
    fixed: bool = False  # to the value that `effect` is, in every run


RULES = tuple(_Rule(**rule) for rule in _DATA["rules"])
WHY: dict[str, str] = _DATA["why"] | {rule.option: rule.why for rule in RULES}
"""Why something becomes of an option, by its name, or by its topic where it is one of many."""
_FIXED = tuple((rule.option, rule.effect) for rule in RULES if rule.fixed)


def forced(settings: Settings, author_scale: float = 1.0) -> tuple[tuple[str, str], ...]:
    """Option and value of everything that a world sets, in a fixed order."""
    world = settings.world
    set_here = [("step-length", repr(world.tick_s)), ("seed", str(settings.seed))]
    if world.demand_scale != 1.0:
        set_here.append(("scale", repr(author_scale * world.demand_scale)))
    if world.jam_teleport_s is not None:
        set_here.append(("time-to-teleport", repr(world.jam_teleport_s)))
    if world.action_step_s is not None:
        set_here.append((_ACTION_STEP, repr(world.action_step_s)))
    if world.street == JUPEDSIM:
        set_here.append((PEOPLE, JUPEDSIM))
    return (*set_here, *_FIXED)


def overrides_of(
    config: Configuration, settings: Settings, moved: Sequence[tuple[str, str]]
) -> tuple[Override, ...]:
    """The rows for one scenario: what is not as its author wrote it, or as SUMO does it.

    Args:
        config: The author's configuration.
        settings: What the world decides.
        moved: Options of the author whose files lie elsewhere, each with the value it gets.
    """
    # 1. What a world sets.
    rows = _forced_rows(config, settings)

    def add(option: str, author: str | None, value: str, why: str) -> None:
        rows.append(Override(option=option, author=author or "", wcsim=value, why=why))

    # 2. What the author writes, and the net where its copy is another one.
    for name, value in moved:
        add(name, config.value(name), value, WHY[NET if name == NET else "outputs"])
    aggregated = config.value(AGGREGATED)
    if config.value("elechybrid-output") and not _same(aggregated or "false", "true"):
        add(AGGREGATED, aggregated, "true", WHY[AGGREGATED])

    # 3. What does nothing in a world.
    for item in config.given:
        name = item.option.name
        if item.option.treatment is Treatment.DROP:
            add(name, item.value, "(left out)", WHY.get(item.option.topic, WHY["no-step-log"]))
        elif name == "end":
            add(name, item.value, "(not the run's end)", WHY[name])
    return tuple(rows)


def _forced_rows(config: Configuration, settings: Settings) -> list[Override]:
    """The rows for what a world sets.

    Shorter steps than the author's change the traffic, unless the drivers' decision interval is
    set.
    """
    rows: list[Override] = []
    chosen = settings.world.action_step_s is not None or config.value(_ACTION_STEP) is not None
    faster = config.number(STEP, 1.0) > settings.world.tick_s and not chosen
    for name, value in forced(settings, config.scale):
        author, default = config.value(name), sumo_options()[name].default
        if _same(default if author is None else author, value):
            continue
        given = f"{default} (default)" if author is None and name == STEP else author
        why = WHY[name] + _FASTER * (faster and name == STEP)
        rows.append(Override(option=name, author=given or "", wcsim=value, why=why))
    return rows


def _same(author: str, value: str) -> bool:
    if author.strip().lower() == value.lower():
        return True
    try:
        return float(author) == float(value)
    except ValueError:
        return is_true(author) and is_true(value)
