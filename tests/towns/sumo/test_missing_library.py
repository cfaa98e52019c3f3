"""A machine without a screen may lack what SUMO leaves to the system: said in a line, with the cure."""

import subprocess
import sys

import pytest

from tests.support.tracked import ROOT
from wcsim.errors import SumoError
from wcsim.towns.scenario.options import sumo_options
from wcsim.towns.sumo import tools

SAID = "libXrender.so.1: cannot open shared object file: No such file or directory"
CURE = "the library libXrender.so.1 is missing; .*sudo apt install libgl1 "


@pytest.fixture
def bare(tmp_path, monkeypatch):
    """A SUMO that the loader does not start."""
    (tmp_path / "bin").mkdir()
    tool = tmp_path / "bin" / "sumo"
    tool.write_text(f"#!/bin/sh\necho '{tool}: error while loading shared libraries: {SAID}' >&2\nexit 127\n")
    tool.chmod(0o755)
    monkeypatch.setattr(tools, "sumo_home", lambda: tmp_path)


def test_a_tool_that_is_not_loaded_says_what_to_install(bare, tmp_path):
    with pytest.raises(SumoError, match=f"sumo cannot be started: {CURE}"):
        tools.run_tool("sumo", ["--version"], tmp_path)
    sumo_options.cache_clear()
    with pytest.raises(SumoError, match=CURE):
        sumo_options()


def test_so_does_libsumo_at_the_command_line():
    code = (
        "import sys\n"
        "class Finder:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        f"        if name == 'libsumo': raise ImportError({SAID!r})\n"
        "sys.meta_path.insert(0, Finder())\n"
        "from wcsim.cli.main import main\n"
        "sys.exit(main(['doctor', '--town', 'helsinki']))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    told = " ".join("".join(letter for letter in done.stdout if letter not in "\u2502\n").split())
    assert done.returncode == 2 and done.stderr == "", done.stderr
    assert "libsumo cannot be loaded: the library libXrender.so.1 is missing" in told


def test_the_image_and_the_readme_have_the_same_list():
    assert f" {tools.SYSTEM_PACKAGES} " in (ROOT / "Dockerfile").read_text()
    assert tools.SYSTEM_PACKAGES in (ROOT / "README.md").read_text()
    assert tools.SYSTEM_PACKAGES in (ROOT / "docs" / "first-minute.md").read_text()
