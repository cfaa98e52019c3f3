"""What the commands say of themselves."""

import re
import tomllib

from tests.support.tracked import ROOT
from wcsim.cli.main import SUBCOMMANDS


def test_help_lists_exactly_the_commands_that_exist(wcsim):
    result = wcsim("--help")
    assert result.code == 0
    listed = re.findall(r"^(?:\w+ | )  *([a-z-]+)  +\w", result.out, flags=re.MULTILINE)
    assert listed == [item.name for item in SUBCOMMANDS]
    homes = {f"wcsim.cli.{item.module.partition(':')[0]}" for item in SUBCOMMANDS}
    beside_main = {f"wcsim.cli.{path.stem}" for path in (ROOT / "wcsim" / "cli").glob("*.py")}
    assert beside_main - {"wcsim.cli.__init__", "wcsim.cli.main"} <= homes
    assert all((ROOT / f"{home.replace('.', '/')}.py").is_file() for home in homes)
    assert max(len(line) for line in result.out.splitlines()) <= 80 and len(result.out.splitlines()) <= 28
    assert wcsim().out == wcsim("help").out == result.out


def test_version(wcsim):
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert wcsim("--version").out.strip() == version
