"""What a change of text must not move, beside golden scenes and towns: `python -m benchmarks.pins FILE`.

It trains, exports and tests for some minutes, and writes a hash of each result; where FILE is there it compares.
Weights hold for one machine: the order of PyTorch's sums depends on the processor.
"""

from __future__ import annotations

import json
import sys
from contextlib import chdir
from pathlib import Path
from typing import Final

from wcsim.agents.opening.list_file import open_suite, write_list
from wcsim.cli.main import main as wcsim
from wcsim.cli.shared.consoles import print_note
from wcsim.core.files import sha256_from_file, write_json
from wcsim.core.own_folder import create_temporary_folder

_Q: Final = "--seed 1 --set learn.learning_starts=100 --set learn.phase1_steps=150"
_COMMANDS: Final = (
    "train --preset quick --seed 1 --out rounds",
    f"train-q {_Q} --steps 400 --out q",
    f"train-clients fig6,fig6 {_Q} --steps 400 --out clients",
    "export rounds --onnx exported --steps 40 --force",
    "test dwa shipped --suite list.json --only --jobs 2 --out tested",
)
_PINNED: Final = ("rounds/data/data.json", "**/*.safetensors", "exported/*.onnx", "tested/episodes.json")


def main(words: list[str]) -> int:
    """Run all commands in an empty folder; 1 if one fails, or a hash is another one than in the file."""
    file = Path(words[0]).absolute()
    suite = open_suite("dev2").file
    with create_temporary_folder() as work, chdir(work):
        write_list(suite.model_copy(update={"blocks": suite.blocks[::8]}), Path("list.json"))
        if any(wcsim(command.split()) for command in _COMMANDS):
            return 1
        found = {str(path): sha256_from_file(path) for form in _PINNED for path in sorted(Path().glob(form))}
    if not file.exists():
        write_json(file, found)
        print_note(f"{len(found)} hashes written")
        return 0
    before = json.loads(file.read_text(encoding="utf-8"))
    moved = sorted({name for name, _ in found.items() ^ before.items()})
    print_note(f"moved: {', '.join(moved)}" if moved else f"{len(found)} hashes as they were")
    return 1 if moved else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
