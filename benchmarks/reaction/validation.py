"""`docs/validation.md`: the street held against streets; a crowd at a gate with a chair, three towns, a junction."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np
from jinja2 import StrictUndefined, Template

from benchmarks.reaction.engineless_world import ReactionStage, touches_chair
from benchmarks.reaction.street_figures import GapsTaken, StreetFigures, critical_gap_s, crowd_figures, spread_of
from benchmarks.reaction.streets import SMALL_STREETS, build_small_street
from wcsim.bridge.reaction.commands import CHAIR, ChairInStreet
from wcsim.config import WorldConfig
from wcsim.core.boxes import gap_to_box
from wcsim.core.processes import drop_stderr_lines
from wcsim.towns.making.asked_town import requested_town
from wcsim.towns.scene_folders.build import build_scene, find_scene
from wcsim.towns.street import load_street
from wcsim.types import ActorState

MODELS = ("striping", "CollisionFreeSpeed", "SocialForce", "GeneralizedCentrifugalForce")
_TOWNS = (("helsinki", "usual"), ("monaco", "usual"), ("manhattan", "usual"), ("made:1", "jupedsim"))
_PAGE = Path(__file__).with_name("validation.md.jinja")
_CHAIR_MPS, _START_X_M, _GATE_S = 0.8, -16.5, 40.0
_STANDS_MPS, _NOBODY = 0.1, (math.nan,) * 5
TOUCHED = "touched"
Figures = dict[str, list[float]]


def page(runs: int, for_s: float, work: Path, told: Callable[[str], object]) -> str:
    """Run everything, so many runs at the gate and so many seconds of each town, and give the page."""
    columns: dict[str, dict[str, dict[str, str]]] = {"gate": {}, "town": {}, "junction": {}}
    for model in MODELS:
        found = _at_the_gate(model, runs, work)
        touched = found.pop(TOUCHED)
        columns["gate"][model] = _texts(found) | {TOUCHED: f"{sum(touched):g} of {len(touched)}"}
        told(f"gate: {model}")
    for name, street in _TOWNS:
        columns["town"][f"{name}, {street}"] = _texts(_in_town(name, street, for_s))
        told(f"{name}: {street}")
    drivers = _of_drivers(6 * for_s, work)
    critical_s = critical_gap_s(*list(drivers.values())[:2])
    columns["junction"]["drivers"] = _texts(drivers)
    template = Template(_PAGE.read_text("utf-8"), keep_trailing_newline=True, undefined=StrictUndefined)
    return str(template.render(columns, critical_s=critical_s, runs=runs, for_s=for_s, sumo=version("libsumo")))


def _texts(figures: Figures) -> dict[str, str]:
    return {name: spread_of(values).told for name, values in figures.items()}


def _at_the_gate(model: str, runs: int, work: Path) -> Figures:
    """The crowd of the scene `narrow-gate` passes with a chair in it, a run for each seed."""
    town, _ = build_scene(find_scene("narrow-gate"), work / f"gate-{model}")
    if striping := model == MODELS[0]:
        config = WorldConfig(attention_share=1.0)
    else:
        text, own = town.sumocfg.read_text("utf-8"), f'<processing><pedestrian.jupedsim.model value="{model}"/>'
        town.sumocfg.write_text(text.replace("<processing>", own), "utf-8")
        config = WorldConfig(street="jupedsim", attention_share=1.0)
    street, found = load_street(town), list[Figures]()
    for seed in range(runs):
        with (
            drop_stderr_lines(b"Error: Error during iteration"),
            ReactionStage(town, street, config, seed, 0.0) as stage,
        ):
            found.append(_pass_the_gate(stage, striping))
    return {name: [value for run in found for value in run[name]] for name in found[0]}


def _pass_the_gate(stage: ReactionStage, halts: bool) -> Figures:
    """One run; with `halts` people stand for the chair, else they only step aside."""
    x_m, rows = _START_X_M, list[tuple[float, dict[str, tuple[float, ...]]]]()
    actors = tuple[ActorState, ...]()
    for _ in range(round(_GATE_S / stage.tick_s)):
        step_m = _CHAIR_MPS * stage.tick_s
        ahead = stage.chair(np.array([x_m + 3.0 * step_m, 0.0]), 0.0)
        waits = any(touches_chair(a, ahead) and a.p_W_m[0] > x_m for a in actors)
        x_m += 0.0 if waits else step_m
        chair = stage.chair(np.array([x_m, 0.0]), 0.0, 0.0 if waits else _CHAIR_MPS)
        actors = tuple(a for a in stage.tick((chair,)) if a.is_person)
        held = _held(stage) if halts else set()
        rows.append((x_m, {a.id: _row(a, chair, a.id in held) for a in actors}))
    names = sorted({name for _, there in rows for name in there})
    tracks = np.array([[there.get(name, _NOBODY) for name in names] for _, there in rows])
    chair_W_m = np.array([(x_m, 0.0) for x_m, _ in rows])
    figures = crowd_figures(tracks[..., :4], chair_W_m, tracks[..., 4])
    return figures | {TOUCHED: [float(name in stage.contacts) for name in names]}


def _held(stage: ReactionStage) -> set[str]:
    return {one.actor_id for one in stage.blocked() if one.behind == CHAIR}


def _row(actor: ActorState, chair: ChairInStreet, held: bool) -> tuple[float, ...]:
    stands = held and _speed(actor) < _STANDS_MPS
    x, y = actor.p_W_m[:2].tolist()
    return x, y, _speed(actor), actor.deflect_m, _free_m(actor, chair) if stands else math.nan


def _in_town(name: str, street: str, for_s: float) -> Figures:
    """The figures of a town's traffic without a chair; a look a second."""
    town, figures = requested_town(name), StreetFigures(every_s=1.0)
    config = WorldConfig.model_validate({"street": street})
    with ReactionStage(town, load_street(town), config, 1, 240.0) as stage:
        for _ in range(round(for_s)):
            for _ in range(round(1.0 / stage.tick_s)):
                stage.tick(())
            figures.add(stage.near(np.zeros((1, 2)), 1e5))
    return figures.values()


def _of_drivers(for_s: float, work: Path) -> Figures:
    """Drivers of a side street turn in; those of the main street stop for a chair that stands on the zebra."""
    taken, refused, stops = list[float](), list[float](), dict[str, float]()
    town = build_small_street(replace(SMALL_STREETS[0], motors_only=True), work / "gaps", 1)
    for seed in range(1, 5):
        gaps = GapsTaken()
        with ReactionStage(town, load_street(town), WorldConfig(attention_share=1.0), seed, 60.0) as stage:
            for tick in range(round(for_s / stage.tick_s)):
                stage.tick(())
                gaps.add(stage.near(np.zeros((1, 2)), 40.0), tick * stage.tick_s)
        for found, more in zip((taken, refused), gaps.taken_refused_s(), strict=True):
            found += more
    town = build_small_street(SMALL_STREETS[0], work / "drivers", 1)
    street = load_street(town)
    with ReactionStage(town, street, WorldConfig(attention_share=1.0), 1, 60.0) as stage:
        for tick in range(round(for_s / stage.tick_s / 2.0)):  # it comes and goes every 20 s
            chair = stage.chair(np.array([70.0, -1.7]), 0.5 * math.pi)
            chairs = (chair,) if tick * stage.tick_s % 40.0 < 20.0 else ()
            actors = stage.tick(chairs)
            held = _held(stage)
            halted = [a for a in actors if chairs and a.id in held and not a.is_person and _speed(a) < _STANDS_MPS]
            stops.update({f"{a.id} {tick // 400}": _free_m(a, chair) for a in halted})
    return {"taken": taken, "let go": refused, "stop gap": list(stops.values())}


def _speed(actor: ActorState) -> float:
    return float(np.hypot(*actor.v_W_mps[:2]))


def _free_m(actor: ActorState, chair: ChairInStreet) -> float:
    """From a body's edge to a chair's; of a vehicle from the middle of its front."""
    front_m = 0.0 if actor.is_person else 0.5 * actor.size_lwh_m[0]
    x = float(actor.p_W_m[0]) + front_m * math.cos(actor.yaw_rad)
    y = float(actor.p_W_m[1]) + front_m * math.sin(actor.yaw_rad)
    radius_m = 0.5 * max(actor.size_lwh_m[:2]) if actor.is_person else 0.0
    return float(gap_to_box(x, y, *chair.row()[:6].tolist())) - radius_m
