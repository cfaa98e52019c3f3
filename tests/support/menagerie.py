"""A street with everything that SUMO can put on one, and the mirror's loop without wheelchairs."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import libsumo
import numpy as np

from wcsim.bridge import mirror
from wcsim.bridge.mirror import _check_mirror
from wcsim.bridge.reaction.articulated import Articulation
from wcsim.bridge.sumo.actors import LONG_M
from wcsim.bridge.sumo.session import SumoOptions, SumoSession
from wcsim.config import WorldConfig
from wcsim.physics.engine import Engine
from wcsim.physics.kinematic_bodies import BodyPool
from wcsim.towns.scenario.overrides import Settings
from wcsim.towns.scene_folders.build import build_scene
from wcsim.types import ActorState

CLASSES = (
    *("private", "emergency", "authority", "army", "vip", "pedestrian", "passenger", "hov", "taxi", "bus", "coach"),
    *("delivery", "truck", "trailer", "motorcycle", "moped", "bicycle", "evehicle", "tram", "rail_urban", "rail"),
    *("rail_electric", "rail_fast", "ship", "container", "cable_car", "subway", "aircraft", "wheelchair", "scooter"),
    *("drone", "custom1", "custom2", "ignoring"),
)
NODES = """<nodes>
    <node id="W" x="-300" y="0"/><node id="C" x="0" y="0" type="{kind}"/><node id="E" x="300" y="0"/>
    <node id="S" x="0" y="-120"/>
</nodes>"""
EDGES = """<edges>
    <edge id="WC" from="W" to="C" type="main"/><edge id="CE" from="C" to="E" type="main"/>
    <edge id="EC" from="E" to="C" type="main"/><edge id="CW" from="C" to="W" type="main"/>
    <edge id="CS" from="C" to="S" type="main"/><edge id="SC" from="S" to="C" type="main"/>
</edges>"""
TYPES = """<types>
    <type id="main" priority="3" numLanes="{lanes}" speed="13.89" sidewalkWidth="3" disallow="pedestrian"/>
</types>"""
SCENE = """name = "menagerie"
shows = "Everything that SUMO can put on a street."
seed = 1
duration_s = 20.0

[[seats]]
start_m = [-22.0, -9.0]
heading_deg = 90.0
goal_m = [40.0, -9.0]

[expect]
crashed = false
"""

_HIT = '<vehicle id="{}" depart="1" departPos="{}" departSpeed="{}" insertionChecks="none"><route edges="WC CE"/>'
HITTING = f'{_HIT.format("ahead", 30, 0)}<stop lane="WC_0" endPos="31" duration="9"/></vehicle>'
HITTING += f"{_HIT.format('behind', 20, 13)}</vehicle>"
"""A vehicle that cannot but drive into another one."""


def build_street(folder: Path, routes: str, additional: str = "", kind: str = "priority", lanes: int = 4) -> Path:
    """A T of three streets with pavements and crossings and this traffic; returns its .sumocfg."""
    source = folder / "source"
    source.mkdir(parents=True)
    texts = {
        "nod": NODES.format(kind=kind),
        "edg": EDGES,
        "typ": TYPES.format(lanes=lanes),
        "con": '<connections><crossing node="C" edges="CS SC" priority="true"/></connections>',
        "rou": f"<routes>{routes}</routes>",
        "add": f"<additional>{additional}</additional>",
    }
    for name, text in texts.items():
        (source / f"street.{name}.xml").write_text(text)
    (source / "scene.toml").write_text(SCENE)
    town, _ = build_scene(source, folder / "built")
    return town.sumocfg


def one_of_each() -> str:
    """A vehicle of every class, standing at the start in one of three lanes, in SUMO's own sizes."""
    text, at_m = [], 0.0
    lengths = {"rail_urban": 109.5, "subway": 109.5, "rail": 135.0, "rail_electric": 200.0, "rail_fast": 200.0,
               "aircraft": 72.7, "ship": 17.0, "trailer": 16.5, "tram": 22.0, "coach": 14.0, "bus": 12.0}  # fmt: skip
    for name in CLASSES:
        at_m += lengths.get(name, 8.0) + 4.0
        lane, pos = 1 + int(at_m // 560), at_m % 560
        lane = 0 if name == "pedestrian" else lane
        edge = ("WC", pos) if pos < 280 else ("CE", pos - 280)
        text.append(f'<vType id="t.{name}" vClass="{name}"/>')
        edges = "WC CE" if edge[0] == "WC" else "CE"
        text.append(
            f'<vehicle id="{name}" type="t.{name}" depart="0" departPos="{max(edge[1], lengths.get(name, 8.0)):.1f}" '
            f'departLane="{lane}" departSpeed="0" insertionChecks="none"><route edges="{edges}"/></vehicle>'
        )
    return "".join(text)


@dataclass
class MirrorLoop:
    """What `World` does each tick between SUMO and the bodies, without wheelchairs and without a street."""

    sumo: SumoSession
    engine: Engine
    pool: BodyPool
    radius_m: float
    substeps: int = 24

    def __post_init__(self) -> None:
        self.articulation = Articulation()
        self.actors: tuple[ActorState, ...] = ()

    def tick(self) -> tuple[ActorState, ...]:
        """One tick; the mirror is compared with the actors at its end."""
        self.sumo.step()
        before = {actor.id: actor for actor in self.actors}
        self.actors = self.articulation.bent(self.sumo.actors(np.zeros((1, 2)), self.radius_m))
        self.pool.place(mirror.moves(before, self.actors, 0.1))
        for _ in range(self.substeps):
            self.engine.step()
        _check_mirror(self.pool, self.actors)
        return self.actors


@contextmanager
def mirror_loop(sumocfg: Path, radius_m: float = 400.0, **options) -> Iterator[MirrorLoop]:
    """A session and an engine, closed at the end. Steps are few and long: empty space needs no fine ones."""
    wanted = SumoOptions(sumocfg=sumocfg, origin_m=(0.0, 0.0), settings=Settings(world=WorldConfig(**options), seed=1))
    with SumoSession(wanted) as sumo, Engine(1 / 100) as engine:
        yield MirrorLoop(sumo=sumo, engine=engine, pool=BodyPool(engine), radius_m=radius_m, substeps=10)


def ids_in_street(radius_m: float) -> set[str]:
    """What libsumo itself says is in the street near the origin: riders and who is being teleported are not.

    A long vehicle is near with any part of it.
    """
    found = set()
    for name in libsumo.vehicle.getIDList():
        x, y = libsumo.vehicle.getPosition(name)
        length_m = libsumo.vehicle.getLength(name)
        if np.hypot(x, y) <= radius_m + (length_m if length_m > LONG_M else 0.0):
            found.add(f"v:{name}")
    for name in libsumo.person.getIDList():
        x, y = libsumo.person.getPosition(name)
        if libsumo.person.getVehicle(name) == "" and np.hypot(x, y) <= radius_m:
            found.add(f"p:{name}")
    return found
