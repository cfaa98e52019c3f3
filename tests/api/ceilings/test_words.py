"""Names use the field's words: `words.toml` lists those that nobody outside of this project would guess."""

import ast
import re
import tomllib

from tests.support.tracked import ROOT, parsed

LIST = tomllib.loads((ROOT / "tests/api/ceilings/words.toml").read_text())


def names(tree: ast.Module) -> set[str]:
    """What a file defines: functions, classes, parameters, variables, attributes."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            found.add(node.id if isinstance(node, ast.Name) else node.attr)
        elif isinstance(node, ast.arg):
            found.add(node.arg)
    return found


def unusual(tree: ast.Module, file: str = "") -> set[str]:
    stay = LIST["stays"]["names"]
    words = {name: re.findall(r"[A-Z]?[a-z]+", name) for name in names(tree) if not {name, f"{file}:{name}"} & {*stay}}
    return {name for name, parts in words.items() if any(part.lower() in LIST["words"] for part in parts)}


def test_rooms_that_were_passed_use_the_words_of_the_field():
    wide = tuple(str(path.parent.relative_to(ROOT)) for path in ROOT.glob("wcsim/**/ruff.toml"))
    files = {name: tree for name, tree in parsed("wcsim").items() if not name.startswith(wide)}
    found = {name: sorted(unusual(tree, name)) for name, tree in files.items()}
    assert {name: words for name, words in found.items() if words} == {}


def test_a_word_is_found_in_any_name():
    tree = ast.parse("def f(row_asked): self.told, x = 1, 2\nclass NewsAtTen: ...\n")
    assert unusual(tree) == {"row_asked", "told", "NewsAtTen"}
