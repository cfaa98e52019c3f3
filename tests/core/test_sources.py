"""What a module is made of: found in the text as Python's own parser finds it."""

import ast
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import pytest

import wcsim
from wcsim.core import sources

ROOT = Path(wcsim.__file__).parent


def parsed(node: ast.AST) -> Iterator[tuple[str, str, str]]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and ast.unparse(child.test) == "TYPE_CHECKING":
            continue
        if isinstance(child, ast.Import):
            yield from ((name.name, "", "") for name in child.names)
        elif isinstance(child, ast.ImportFrom):
            assert child.level == 0 and child.module, "relative imports are not read"
            yield from ((child.module, name.name, name.asname or name.name) for name in child.names)
        yield from parsed(child)


@pytest.mark.parametrize("folder", sorted({path.parent.relative_to(ROOT).as_posix() for path in ROOT.rglob("*.py")}))
def test_imports_are_read_as_python_reads_them(folder: str) -> None:
    for path in (ROOT / folder).glob("*.py"):
        text = path.read_text()
        found = sources._imports(sources._FOR_TYPES_ALONE.sub("", text))
        assert sorted(found) == sorted(parsed(ast.parse(text))), path


def test_only_what_is_needed_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    texts = {
        "a": "from typing import TYPE_CHECKING\n\nfrom wcsim.door import B, T as S\n\n"
        "if TYPE_CHECKING:\n    from wcsim.never import N\n\n\ndef late():\n    import wcsim.deep.late\n",
        "door": "from wcsim.b import B as B\nfrom wcsim.t import T as T\nfrom wcsim.c import C as C\n",
        "b": "from wcsim import (\n    seeds,  # a module by its name\n)\n",
        "deep/late": "import numpy as np\n",
        **dict.fromkeys(("t", "c", "seeds", "never", "deep/__init__", "__init__"), ""),
    }
    for name, text in texts.items():
        path = tmp_path / "wcsim" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    monkeypatch.setattr(sources, "_ROOT", tmp_path)
    found = sources.find_imported_source_files("wcsim.a")
    assert [path.relative_to(tmp_path / "wcsim").as_posix() for path in found] == [
        "a.py", "b.py", "deep/late.py", "seeds.py", "t.py",
    ]  # fmt: skip
    assert {name for path in found for name in sources._parsed(path)[1]} == {"typing", "numpy"}


@pytest.mark.parametrize(
    "installed, told",
    [
        ({"pybullet": "3.2.7"}, "3.2.7"),
        ({"pybullet-arm64": "3.2.8"}, "3.2.7"),
        ({"pybullet-arm64": "3.2.9"}, "pybullet-arm64-3.2.9"),
        ({}, ""),
    ],
)
def test_the_fork_counts_as_the_release_whose_bytes_it_gives(
    installed: dict[str, str], told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def version(name: str) -> str:
        if name in installed:
            return installed[name]
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "version", version)
    assert sources.read_package_version("pybullet") == told and sources.read_package_version("numpy") == ""
