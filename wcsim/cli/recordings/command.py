"""`wcsim users record | fit`."""

from __future__ import annotations

from importlib import import_module

from wcsim.cli.shared.common import parse, subcommand

COMMANDS = {"record": "UserRecordOptions", "fit": "UserFitOptions"}
"""The commands, each a file here, named user_ and so, with a `run(options)`, and its class of options."""


def run(words: list[str]) -> int:
    """Run one of them; only its own file is loaded."""
    name = subcommand(words, "users", COMMANDS, _options_of)
    if not name:
        return 0
    return int(import_module(_home(name)).run(parse(_options_of(name), words[1:], f"users {name}")))


def _options_of(name: str) -> type:
    """A command's class of options."""
    found: type = getattr(import_module(_home(name)), COMMANDS[name])
    return found


def _home(name: str) -> str:
    return f"{__package__}.user_{name}"
