"""Clients that grow, in processes of their own: replaced at the begin of an epoch, and nobody loses a step."""

import pytest

from tests.cli.conftest import finished, parsed, start
from tests.cli.training.test_clients import SMALL
from tests.support.events import read_events
from wcsim.agents.runs.run_folder import open_run

LEAKY = """
import torch
from torch import nn

KEPT = []


class Leaky(nn.Module):
    def __init__(self, image_shape, vector_size):
        super().__init__()
        self.dense = nn.Linear(vector_size, 8)

    def forward(self, image, vector):
        KEPT.append(bytearray(b"x" * 300_000))
        return torch.relu(self.dense(vector))
"""


@pytest.mark.proof
def test_a_client_that_grows_is_replaced_and_nobody_loses_a_step(tmp_path, corner):
    (tmp_path / "own.py").write_text(LEAKY)
    settings = ("learn.process_growth_mb=15", "learn.replay_frames=100", "world.epoch_ticks=230")
    words = ("patch,own:Leaky", "--steps", 1500, "--out", "run", "--json", "x.json")
    child = start(
        tmp_path, "train-clients", "--town", corner, *words, *SMALL, *(w for s in settings for w in ("--set", s))
    )
    finished(child, 400)
    result = parsed(tmp_path / "x.json")
    assert [(c["missing"], c["duplicated"]) for c in result["clients"]] == [(0, 0), (0, 0)]
    events = read_events(tmp_path / "run")
    replaced = [event for event in events if event["event"] == "replaced" and event["who"] == "Leaky"]
    assert len(replaced) >= 2 and "has grown from" in replaced[0]["reason"], events
    assert [event for event in events if event["event"] == "death"] == []
    assert {open_run(tmp_path / "run" / name).manifest.steps for name in ("patch", "Leaky")} == {1500}
