"""`wcsim collect`: what it refuses before it drives."""

import json
from pathlib import Path

from tests.agents.export.test_danger_graph import CONFIG, network
from tests.cli.conftest import files_in, parsed
from tests.cli.test_bad_input import refused
from wcsim.agents.danger.policy import save_danger
from wcsim.config.run_file import DangerRuleSettings


def test_a_network_with_an_eye_of_somebodys_own_drives_when_that_is_named(wcsim, folder, corner):
    save_danger(folder / "seeing", network(eye="picture"), DangerRuleSettings(), CONFIG)
    said = parsed("seeing/policy.json")
    Path("seeing/policy.json").write_text(json.dumps({**said, "net": {**said["net"], "network": "own_eye_f:Own"}}))
    before = files_in(folder)
    words = ("collect", "--town", corner, "--policy", "seeing", "--out", "data")
    refused(wcsim(*words), "runs its code; if you trust it, name it: --network own_eye_f:Own")
    refused(wcsim(*words, "--network", "own_eye_f:Own"), "network module 'own_eye_f' was not found")
    assert files_in(folder) == before
