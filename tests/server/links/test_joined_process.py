"""What a client loads that joins a world elsewhere: no simulator, no renderer."""

import json
import subprocess
import sys
from pathlib import Path

from tests.server.servers import Server, stand_in_order
from tests.support.typed import python_says
from wcsim.agents.clients import client
from wcsim.agents.envs import wheelchair_env
from wcsim.bridge import world
from wcsim.bridge.sumo import open_scenario, session
from wcsim.physics import engine
from wcsim.physics.renderer import kernels
from wcsim.server.specs import SeatRequest, encode_json_line
from wcsim.types import SeatSpec

LIBRARIES = ("libsumo", "traci", "sumolib", "pybullet", "shapely", "networkx")
MODULES = tuple(module.__name__ for module in (open_scenario, session, world, engine, kernels))
CODE = f"""
import json, sys
import {client.__name__}, {wheelchair_env.__name__}
from wcsim import WheelchairEnv
from wcsim.config import RunConfig
from wcsim.server.specs import SeatRequest, decode_json_line
config = RunConfig.model_validate_json(sys.argv[2])
env = WheelchairEnv(config=config, join=decode_json_line(SeatRequest, sys.argv[1].encode()))
env.reset()
for _ in range(3):
    step = env.step(40)
print(json.dumps([step.info["event_step"], [name for name in {LIBRARIES + MODULES} if name in sys.modules]]))
env.close()
"""


def test_a_client_that_joined_and_drove_has_loaded_no_simulator(tmp_path: Path) -> None:
    with Server(stand_in_order(tmp_path, seats=1), tmp_path) as server:
        server.status()
        order: SeatRequest = server.seat("env", spec=SeatSpec())
        words = [sys.executable, "-c", CODE, encode_json_line(order).decode(), server.order.config.model_dump_json()]
        run = subprocess.run(words, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert json.loads(run.stdout.splitlines()[-1]) == [3, []]


def test_what_must_not_be_loaded_is_what_a_world_loads_and_that_loads_nothing_that_only_builds_streets() -> None:
    """Otherwise the list above would hold names that nothing loads any more."""
    none = ("cv2", "rasterio", "torch", "wcsim.towns.build_street")
    looked = LIBRARIES + MODULES + none
    code = f"import sys, wcsim.server.host.opening; print([n for n in {looked} if n not in sys.modules])"
    assert python_says(code) == str(list(none))
