"""What wcsim overrides of a scenario's own options: one list of rules, which `tools/overrides_page.py` prints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from wcsim.config import RunConfig
from wcsim.towns.scenario.options import Configuration, Treatment, sumo_options
from wcsim.towns.sumo.xml_io import is_true


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

    step_s: float
    seed: int
    demand_scale: float = 1.0  # times the author's own
    jam_teleport_s: float | None = None  # None keeps the author's
    action_step_s: float | None = None  # how often drivers decide; None keeps the author's


def settings_of(config: RunConfig, seed: int) -> Settings:
    """What a run decides about a scenario; `seed` is SUMO's own."""
    world = config.world
    return Settings(
        step_s=world.tick_s,
        seed=seed,
        demand_scale=world.demand_scale,
        jam_teleport_s=world.jam_teleport_s,
        action_step_s=world.action_step_s,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Rule:
    """What happens to an option, in words for the guide; `value` is fixed, or "" where it depends on the run."""

    option: str
    says: str
    why: str
    value: str = ""


STEP, _ACTION_STEP = "step-length", "default.action-step-length"
JUMPING = "nonInteracting"
"""Of the models of pedestrians, the one whose people have no way between two streets."""
RULES = (
    _Rule(option="step-length", says="`world.tick_s`", why="one tick is one step of SUMO"),
    _Rule(
        option=_ACTION_STEP,
        says="kept, unless `world.action_step_s` is set",
        why="the run sets how often drivers decide",
    ),
    _Rule(option="seed", says="drawn from `--seed`", why="one seed for all random draws"),
    _Rule(option="random", says="false", value="false", why="equal seeds give equal traffic"),
    _Rule(
        option="scale",
        says="the scenario's value times `world.demand_scale`; kept while that is 1",
        why="the run sets the amount of traffic",
    ),
    _Rule(
        option="time-to-teleport",
        says="kept, unless `world.jam_teleport_s` is set",
        why="the run sets when a jam ends",
    ),
    _Rule(
        option="pedestrian.model",
        says=f"kept; with `{JUMPING}` pedestrians jump between streets and ignore wheelchairs",
        why="SUMO moves pedestrians",
    ),
    _Rule(option="no-step-log", says="true", value="true", why="wcsim writes to the console"),
    _Rule(option="no-warnings", says="true", value="true", why="wcsim writes to the console"),
    _Rule(option="duration-log.disable", says="true", value="true", why="wcsim writes to the console"),
    _Rule(option="xml-validation", says="never", value="never", why="no schema is downloaded"),
    _Rule(option="xml-validation.net", says="never", value="never", why="no schema is downloaded"),
    _Rule(option="xml-validation.routes", says="never", value="never", why="no schema is downloaded"),
)
_FIXED = tuple((rule.option, rule.value) for rule in RULES if rule.value)
_WHY = {rule.option: rule.why for rule in RULES}
_FASTER = (
    "; traffic that was calibrated for longer steps drives 10 to 20 % faster; to correct it, set world.action_step_s "
    "to 0.5 to 0.7 of the scenario's step"
)
END_WHY = "flows without an end of their own need it; the run decides when it stops"
OUTPUT_WHY = "outputs go to the run folder only"
DROP_WHY = {
    "configuration": "a run writes no configurations",
    "gui_only": "there is no window",
    "traci_server": "no other program controls this simulation",
}
PREFIX_WHY = "outputs keep their names"
AGGREGATED = "elechybrid-output.aggregated"
UNASKED_WHY = {
    "device.ssm.file": "SUMO's default is the current folder",
    "save-state.prefix": "SUMO's default is beside the configuration",
    AGGREGATED: "otherwise vehicle ids would become file names",
}


def forced(settings: Settings, author_scale: float = 1.0) -> tuple[tuple[str, str], ...]:
    """Option and value of everything that a world sets, in a fixed order."""
    set_here = [("step-length", repr(settings.step_s)), ("seed", str(settings.seed))]
    if settings.demand_scale != 1.0:
        set_here.append(("scale", repr(author_scale * settings.demand_scale)))
    if settings.jam_teleport_s is not None:
        set_here.append(("time-to-teleport", repr(settings.jam_teleport_s)))
    if settings.action_step_s is not None:
        set_here.append((_ACTION_STEP, repr(settings.action_step_s)))
    return (*set_here, *_FIXED)


def overrides_of(config: Configuration, settings: Settings, outputs: Sequence[tuple[str, str]]) -> tuple[Override, ...]:
    """The rows for one scenario: only what differs from what its author wrote, or what SUMO would else do.

    Args:
        config: The author's configuration.
        settings: What the world decides.
        outputs: Options of the author that write files, each with the value it gets.
    """
    files = [_override(config, name, value, OUTPUT_WHY) for name, value in outputs]
    return (*_forced_rows(config, settings), *files, *_aggregated_rows(config), *_idle_rows(config))


def _override(config: Configuration, name: str, value: str, why: str) -> Override:
    return Override(option=name, author=config.value(name) or "", wcsim=value, why=why)


def _forced_rows(config: Configuration, settings: Settings) -> Iterator[Override]:
    """What a world sets, where that is another value than it would have been."""
    for name, value in forced(settings, author_scale(config)):
        author, default = config.value(name), sumo_options()[name].default
        if not _same(default if author is None else author, value):
            given = f"{default} (default)" if author is None and name == STEP else author or ""
            why = _WHY[name] + _faster(author or default, config, settings) * (name == STEP)
            yield Override(option=name, author=given, wcsim=value, why=why)


def _aggregated_rows(config: Configuration) -> Iterator[Override]:
    if config.value("elechybrid-output") and not _same(config.value(AGGREGATED) or "false", "true"):
        yield _override(config, AGGREGATED, "true", UNASKED_WHY[AGGREGATED])


def _idle_rows(config: Configuration) -> Iterator[Override]:
    """Options of the author that do nothing in a world."""
    for item in config.given:
        topic, name = item.option.topic, item.option.name
        if item.option.treatment is Treatment.DROP:
            why = DROP_WHY.get(topic, PREFIX_WHY if topic == "output" else _WHY["no-step-log"])
            yield Override(option=name, author=item.value, wcsim="(left out)", why=why)
        elif name == "end":
            yield Override(option="end", author=item.value, wcsim="(not the run's end)", why=END_WHY)


def _faster(author: str, config: Configuration, settings: Settings) -> str:
    """What shorter steps than the author's do to the traffic, unless the drivers' decision interval is set."""
    chosen = settings.action_step_s is not None or config.value(_ACTION_STEP) is not None
    return _FASTER if _seconds(author) > settings.step_s and not chosen else ""


def _seconds(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return 0.0  # as hours:minutes:seconds, which no step is written in


def author_scale(config: Configuration) -> float:
    """The author's own factor of the demand."""
    try:
        return float(config.value("scale") or 1.0)
    except ValueError:
        return 1.0  # SUMO refuses it with a message of its own


def _same(author: str, value: str) -> bool:
    if author.strip().lower() == value.lower():
        return True
    try:
        return float(author) == float(value)
    except ValueError:
        return is_true(author) and is_true(value)
