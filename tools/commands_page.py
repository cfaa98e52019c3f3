"""`docs/commands.md`: all commands and their options, from the code."""

from __future__ import annotations

import contextlib
import io
import os
import re
from itertools import groupby

from wcsim.cli.main import SUBCOMMANDS, main

HEAD = """# Commands

The commands of `wcsim` by task, each with its options, as `wcsim COMMAND --help` prints them.
`python -m tools.pages` generates this page from the code.
"""


def page() -> str:
    """The page, in Markdown."""
    parts = [HEAD]
    for task, group in groupby(SUBCOMMANDS, lambda item: item.task):
        parts.append(f"## {task[0].upper()}{task[1:]}\n")
        parts += [_command((item.name,)) for item in group]
    return "\n".join(parts)


def _command(words: tuple[str, ...]) -> str:
    told = help_of(words)
    if inner := re.match(r"usage: wcsim \S+ ([a-z|]+) \[options\]", told):
        return "\n".join(_command((*words, word)) for word in inner[1].split("|"))
    return f"### wcsim {' '.join(words)}\n\n```text\n{told.strip()}\n```\n"


def help_of(words: tuple[str, ...]) -> str:
    """What a command says of itself on a terminal of 100 columns, without boxes."""
    os.environ["COLUMNS"] = "100"
    with contextlib.redirect_stdout(io.StringIO()) as out:
        main([*words, "--help"])
    lines = [re.sub(r"^[│╭╰]?[─-]* |[ ─-]*[│╮╯]?$", "", line) for line in out.getvalue().split("\n")]
    return re.sub(r"\n{3,}", "\n\n", "\n".join(line for line in lines if set(line) != {"─"}))
