"""`wcsim collect`: what it refuses before it drives."""

import json
from pathlib import Path

from tests.agents.export.test_danger_graph import CONFIG, network
from tests.cli.conftest import files_in, parsed
from tests.cli.test_bad_input import refused
from wcsim.agents.danger.policy import save_danger
from wcsim.config.run_file import DangerRuleSettings


def test_a_network_of_camera_pictures_drives_no_more(wcsim, folder, corner):
    save_danger(folder / "seeing", network(), DangerRuleSettings(), CONFIG)
    said = parsed("seeing/policy.json")
    Path("seeing/policy.json").write_text(json.dumps({**said, "net": {**said["net"], "eye": "picture"}}))
    before = files_in(folder)
    told = wcsim("collect", "--town", corner, "--policy", "seeing", "--out", "data")
    refused(told, "unknown key 'net.eye'", "remove it")
    assert files_in(folder) == before
