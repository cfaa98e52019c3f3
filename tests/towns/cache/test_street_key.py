"""A built street is kept until something changes of which it is made; no edit elsewhere costs anybody a minute."""

import shutil
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

import pytest

import wcsim
from wcsim.core import jit, seeding, sources
from wcsim.towns import build_street, street
from wcsim.towns.ground import mesh, tiles
from wcsim.towns.importing import demand, importer
from wcsim.towns.osm import read
from wcsim.towns.scenario import stage
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo import net
from wcsim.types import arrays, episode
from wcsim.types import street as street_types

ROOT = Path(wcsim.__file__).parent


@pytest.fixture(autouse=True)
def _forgotten() -> Iterator[None]:
    yield
    forget()


@pytest.fixture
def copy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The package's text in a folder of its own, which is what counts as long as this test runs."""
    shutil.copytree(ROOT, tmp_path / "wcsim", ignore=lambda _, names: [n for n in names if n == "__pycache__"])
    monkeypatch.setattr(sources, "_ROOT", tmp_path)
    return tmp_path


def forget() -> None:
    """What a process has read of its code, as in one that begins."""
    sources._parsed.cache_clear()
    street._maker_digest.cache_clear()


def key_of(town: Town) -> str:
    forget()
    return street._street_key(town)


def edit(copy: Path, module: ModuleType, more: str = "# a comment\n") -> None:
    path = copy / Path(str(module.__file__)).relative_to(ROOT.parent)
    path.write_text(path.read_text() + more)


def test_what_makes_a_street_makes_its_name(copy: Path, corner_town: Town) -> None:
    keys = [key_of(corner_town)]
    for module in (build_street, net, mesh, tiles, street_types, arrays, seeding, jit):
        edit(copy, module)
        keys.append(key_of(corner_town))
    assert len(set(keys)) == len(keys)


def test_so_do_the_models_of_furniture(copy: Path, corner_town: Town) -> None:
    before = key_of(corner_town)
    looks = copy / "wcsim" / "towns" / "furniture" / "models.toml"
    looks.write_text(looks.read_text().replace("size = [1.6,", "size = [1.7,"))
    assert key_of(corner_town) != before


def test_what_only_stands_beside_it_does_not(copy: Path, corner_town: Town) -> None:
    key = key_of(corner_town)
    for module in (read, importer, demand, stage, episode, street, sys.modules["wcsim.config"], wcsim):
        edit(copy, module)
    assert key_of(corner_town) == key


def test_a_file_in_a_folder_below_counts_from_the_import_on(copy: Path, corner_town: Town) -> None:
    below = copy / "wcsim" / "towns" / "deep" / "er.py"
    below.parent.mkdir()
    below.with_name("__init__.py").write_text('"""Gathers names."""\n\nfrom wcsim.towns.deep.er import EDGE as EDGE\n')
    below.write_text("EDGE = 1\n")
    before = key_of(corner_town)
    edit(copy, net, "\nfrom wcsim.towns.deep import EDGE\n")
    imported = key_of(corner_town)
    below.write_text("EDGE = 2\n")
    assert len({before, imported, key_of(corner_town)}) == 3


def test_the_versions_of_all_its_libraries_count(corner_town: Town, monkeypatch: pytest.MonkeyPatch) -> None:
    files = sources.find_imported_source_files(build_street.__name__)
    used = {name for path in files for name in sources._parsed(path)[1]} - sys.stdlib_module_names
    assert used == set(street.LIBRARIES)
    key, known = key_of(corner_town), {name: version(name) for name in street.LIBRARIES.values()}
    for library in known:
        with monkeypatch.context() as patch:
            patch.setattr(street, "version", {**known, library: "0.0"}.__getitem__)
            assert key_of(corner_town) != key
