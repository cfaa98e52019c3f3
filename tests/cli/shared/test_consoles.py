"""Results go to stdout and all else to stderr; names stay what they are."""

import re
from pathlib import Path

import wcsim.cli
from wcsim.cli.shared.consoles import show_table, stderr_console, stdout_console

TOLD = "town :car: of 12 streets in d[/x] and [bold]"


def test_results_and_notes_go_their_own_ways(capsys):
    stdout_console().print(TOLD)
    stderr_console().print(f"note: {TOLD}")
    told = capsys.readouterr()
    assert told.out.splitlines() == [TOLD]
    assert told.err.splitlines() == [f"note: {TOLD}"]


def test_a_table_shows_a_name_as_it_is(capsys):
    show_table(["name"], [["d[/x]"]], title="[red]a[/]")
    told = capsys.readouterr().out
    assert "d[/x]" in told and "[red]a[/]" in told


def test_every_command_has_its_consoles_from_here():
    """A console of a command's own once showed a class called Robot as a picture."""
    files = Path(wcsim.cli.__file__).parent.rglob("*.py")
    made = [path.name for path in files if re.search(r"\bConsole\(", path.read_text())]
    assert made == ["consoles.py"]
