"""Classes of a user's own, module:Class."""

import sys
from pathlib import Path

import pytest

from wcsim.core.plugins import find_user_class_files, import_class, wrap_user_code_errors
from wcsim.errors import HookError, PolicyError


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, with three files in it, which is not on the Python path."""
    (tmp_path / "own_base_net.py").write_text("class Base:\n    size = 3\n")
    (tmp_path / "own_big_net.py").write_text(
        "from own_base_net import Base\nclass Bigger(Base):\n    def late(self):\n"
        "        import own_late_part\n        return own_late_part.SAID\n"
    )
    (tmp_path / "own_late_part.py").write_text("SAID = 'late'\n")
    (tmp_path / "own_broken_net.py").write_text("import own_neighbour_that_is_not_there\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    monkeypatch.setattr(sys, "path", [item for item in sys.path if item])
    for name in ("own_base_net", "own_big_net", "own_late_part", "own_broken_net"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    return tmp_path


def refused(name: str, told: str) -> None:
    with pytest.raises(PolicyError, match=told):
        import_class(name, "network")


def test_a_module_of_the_current_folder_finds_its_neighbours_also_later(folder):
    found = import_class("own_big_net:Bigger", "network")
    assert found.size == 3 and found().late() == "late"
    assert import_class("own_base_net:Base", "network") in found.__mro__


def test_several_modules_of_the_current_folder_are_found(folder):
    for name in ("own_base_net", "own_late_part"):
        (folder / f"{name}.py").write_text("class Net:\n    pass\n")
        assert import_class(f"{name}:Net", "network").__module__ == name


def test_what_is_nowhere_is_said(folder):
    refused("own_missing:Net", r"was not found; expected own_missing\.py in")
    refused("own_broken_net:Net", r"failed to import: .*own_neighbour_that_is_not_there")


def test_what_is_installed_comes_before_the_current_folder(folder):
    (folder / "colorsys.py").write_text("class Net:\n    pass\n")
    import_class("own_base_net:Base", "network")
    refused("colorsys:Net", "colorsys has no class 'Net'")


def test_the_sources_of_a_class_are_its_file_and_what_it_imports_beside_it(folder):
    (folder / "own_unused.py").write_text("")
    (folder / "runs").mkdir()  # no package, whatever imports one of its name
    (folder / "own_base_net.py").write_text(
        "import numpy, wcsim.errors\nclass Base:\n    size = 3\n    def late(self):\n        import runs\n"
    )
    names = ["own_base_net.py", "own_big_net.py", "own_late_part.py"]
    assert list(find_user_class_files("own_big_net:Bigger", "network")) == names
    assert find_user_class_files("json.decoder:JSONDecoder", "network").keys() == {"decoder.py"}


def test_a_folder_that_is_no_package_yet_is_named(folder, monkeypatch):
    (folder / "own_parts").mkdir()
    (folder / "own_parts" / "mine.py").write_text("class Net:\n    pass\n")
    refused("own_parts.mine:Net", r"own_parts has no __init__\.py")
    (folder / "own_parts" / "__init__.py").touch()
    for name in ("own_parts", "own_parts.mine"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    assert find_user_class_files("own_parts.mine:Net", "network").keys() == {
        "own_parts/__init__.py",
        "own_parts/mine.py",
    }
    refused("own_parts.yours:Net", r"expected own_parts/yours\.py in")


def test_what_ones_own_code_raises_becomes_one_line_that_says_where():
    told = r"my hook: ZeroDivisionError: .* \(.*test_plugins\.py, line \d+\); mend it"
    with pytest.raises(HookError, match=told), wrap_user_code_errors("my hook", "mend it", HookError):
        raise ZeroDivisionError("of mine")


def test_errors_of_wcsim_pass_ones_own_code_as_they_are():
    with pytest.raises(PolicyError, match=r"^no such weights$"), wrap_user_code_errors("my hook", "mend it", HookError):
        raise PolicyError("no such weights")
