"""The files that belong to the project: what commands and people leave beside them is nobody's subject."""

import ast
import subprocess
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]


@cache
def tracked(under: str = "", suffix: str = "") -> tuple[Path, ...]:
    """Files that git tracks in a folder, sorted; in an unpacked source archive all that git would not ignore."""
    git = ROOT / ".git"
    if not git.exists():
        ignored = {line.strip("/") for line in (ROOT / ".gitignore").read_text().splitlines()}
        names = [path.relative_to(ROOT) for path in (ROOT / under).rglob("*") if "__pycache__" not in path.parts]
        found = {ROOT / name for name in names if name.parts[0] not in ignored}
    else:
        words = ["git", f"--git-dir={git}", f"--work-tree={ROOT}", "ls-files", "-z", "--", under or "."]
        listed = subprocess.run(words, cwd=ROOT, stdout=subprocess.PIPE, check=True)
        found = {ROOT / name for name in listed.stdout.decode().split("\0") if name}
    return tuple(sorted(path for path in found if path.is_file() and path.name.endswith(suffix)))


@cache
def parsed(under: str) -> dict[str, ast.Module]:
    """The syntax trees of a folder's Python files, by their path in the repository."""
    return {str(path.relative_to(ROOT)): ast.parse(path.read_text()) for path in tracked(under, ".py")}
