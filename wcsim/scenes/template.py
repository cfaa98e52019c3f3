"""A small scene that runs as it is, to start one's own from: a zebra, a car, a wheelchair."""

import re
from pathlib import Path

from wcsim.core.files import write_folder_atomically
from wcsim.errors import TownError

# Texts of users: some of their lines are long.
_FILES = {
    "street.nod.xml": """\
<nodes>
    <!-- x is east, y is north, in metres; the zebra lies at C. A height z in metres would make a slope. -->
    <node id="W" x="-60" y="0" type="priority"/>
    <node id="C" x="0" y="0" type="priority"/>
    <node id="E" x="60" y="0" type="priority"/>
</nodes>
""",  # noqa: E501
    "street.typ.xml": """\
<types>
    <!-- one lane each way and a pavement of 2.5 m: the kerb is at y = 3.25, the pavement's middle at y = 4.5 -->
    <type id="street" priority="3" numLanes="1" speed="11.11" width="3.25" sidewalkWidth="2.5"
          disallow="pedestrian wheelchair"/>
</types>
""",  # noqa: E501
    "street.edg.xml": """\
<edges>
    <edge id="WC" from="W" to="C" type="street"/>
    <edge id="CW" from="C" to="W" type="street"/>
    <edge id="EC" from="E" to="C" type="street"/>
    <edge id="CE" from="C" to="E" type="street"/>
</edges>
""",
    "street.con.xml": """\
<connections>
    <!-- kerbs are lowered where a crossing meets the pavement -->
    <crossing node="C" edges="WC CW" priority="true" width="4"/>
</connections>
""",
    "street.rou.xml": """\
<routes>
    <vType id="car" vClass="passenger" length="4.5" width="1.8" height="1.5"/>
    <!-- vehicles and persons, in the order of their departures -->
    <vehicle id="car.west" type="car" depart="0" departPos="5" departSpeed="max"><route edges="EC CW"/></vehicle>
</routes>
""",  # noqa: E501
    "street.add.xml": """\
<additional>
    <!-- objects: wcsim.sign, wcsim.bench, wcsim.roadworks, ... and SUMO's own parking areas and stops -->
    <poi id="sign" type="wcsim.sign" x="-20" y="-5.4" angle="90"/>
</additional>
""",  # noqa: E501
    "scene.toml": """\
name = "{name}"
shows = "A wheelchair crosses at a zebra; a car brakes, lets it pass and drives on."
seed = 1
duration_s = 16.0
kerb_height_m = 0.12
# lefthand = true         # traffic keeps to the left
# warmup_s = 30.0         # traffic before the scene begins
# attention_share = 1.0   # share of road users that notice the chair

[[seats]]                 # one block for each wheelchair
start_m = [0.0, -5.5]     # as in the .nod.xml
heading_deg = 0.0         # SUMO's: 0 is north, 90 is east
script = [[0.0, 0.0, 0.6], [10.8, 0.0, 0.0]]   # from this second on: right, forward
# joystick = [0.0, 0.6]   # or instead of the script: held all the time; or a simulated user with a goal:
# goal_m = [-30.0, -4.5]
# profile = "competent"

[expect]                  # lowest and highest value that passes; scene run --json FILE writes all of them
crashed = false
closest_vehicle_m = [0.8, 2.5]
gave_way = [1, 1]
went_on = [1, 1]
""",  # noqa: E501
}


def write_scene(home: Path, name: str) -> Path:
    """Write the template as the folder `name` in `home`, whole or not at all, and return it.

    Raises:
        TownError: It has no such name, or is there already.
        DiskFullError: It cannot be written.
    """
    if not re.fullmatch(r"[A-Za-z0-9_-]{1,64}", name):
        raise TownError(
            f"a scene cannot be named {name!r}; expected up to 64 letters, digits, - and _"
        )
    folder = home / name
    if folder.exists():
        raise TownError(f"{folder} already exists; choose another name, or remove it first")
    with write_folder_atomically(folder) as part:
        for file, text in _FILES.items():
            (part / file).write_text(text.replace("{name}", name), encoding="utf-8")
    return folder
