"""The examples of docs/faces.md, as they stand there but for the town, the size and the length."""

import re
import runpy
from pathlib import Path

import pytest

from tests.server.servers import Server, stand_in_order
from wcsim.config import resolve
from wcsim.server.protocol.events import ServerRules

PAGE = (Path(__file__).parents[3] / "docs" / "faces.md").read_text()
EXAMPLES = re.findall(r"^## (.+?)\n.*?^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
NO_WARMUP = 'overrides=("world.warmup_s=0", "env.max_steps=20")'


def run(code: str, folder: Path) -> None:
    """As a script of its own; a warning is an error here too."""
    file = folder / "example.py"
    file.write_text(code)
    runpy.run_path(str(file), run_name="__main__")


def test_every_face_has_an_example():
    assert [name for name, _ in EXAMPLES] == [
        "Gymnasium", "PettingZoo", "Stable-Baselines3", "A seat of a running world"
    ]  # fmt: skip


@pytest.mark.parametrize("name, code", EXAMPLES[:3], ids=[name for name, _ in EXAMPLES[:3]])
def test_an_example_runs(name, code, corner, tmp_path):
    assert code.count('"helsinki"') == 1
    code = code.replace('"helsinki"', f"{str(corner)!r}, {NO_WARMUP}").replace("10_000", "108")
    run(code, tmp_path)


def test_the_example_of_a_shared_world_runs(tmp_path):
    config = resolve("quick")
    rules = ServerRules(capacity=1, config=config.world_digest())
    order = stand_in_order(tmp_path, rules=rules, config=config)
    with Server(order, tmp_path) as server:
        server.status()
        code = EXAMPLES[3][1]
        assert "ipc:///tmp/street/world" in code
        run(code.replace("ipc:///tmp/street/world", order.endpoint), tmp_path)
