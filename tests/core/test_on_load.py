"""What follows a library's import: at once, or as soon as somebody loads it."""

import subprocess
import sys
from pathlib import Path

import pytest

from wcsim.core.on_load import call_on_import

BEFORE = "import wcsim, sys; assert 'gymnasium' not in sys.modules and 'numpy' not in sys.modules; import gymnasium"
AFTER = "import gymnasium, wcsim"
BETWEEN = "import wcsim, gymnasium.envs.registration, gymnasium"


@pytest.fixture
def late(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "late_library.py").write_text("value = 3\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "meta_path", list(sys.meta_path))
    monkeypatch.delitem(sys.modules, "late_library", raising=False)
    return "late_library"


def test_it_is_called_once_with_the_module_when_that_is_complete(late: str) -> None:
    seen: list[int] = []
    call_on_import(late, lambda module: seen.append(module.value))
    assert (seen, late in sys.modules) == ([], False)
    import late_library

    assert seen == [3]
    del sys.modules[late]
    import late_library  # noqa: F811

    assert (seen, late_library.value) == ([3], 3)


def test_the_module_keeps_its_own_loader(late: str) -> None:
    call_on_import(late, lambda module: None)
    import late_library

    assert late_library.__spec__.loader is late_library.__loader__
    assert late_library.__loader__.get_source(late) == "value = 3\n"


def test_it_is_called_at_once_for_a_module_that_is_there(late: str) -> None:
    import late_library

    seen: list[object] = []
    watching = list(sys.meta_path)
    call_on_import(late, seen.append)
    assert (seen, sys.meta_path) == ([late_library], watching)


def test_a_library_that_is_not_there_is_missed_as_ever(late: str) -> None:
    call_on_import("no_such_library", lambda module: pytest.fail("there is no such library"))
    with pytest.raises(ModuleNotFoundError, match="no_such_library"):
        import no_such_library  # noqa: F401


@pytest.mark.parametrize("first", [BEFORE, AFTER, BETWEEN], ids=["before", "after", "by one of its modules"])
def test_gymnasium_knows_the_environment_whichever_is_imported_first(first: str) -> None:
    code = f"{first}; print(gymnasium.spec(wcsim.ENV_ID).entry_point)"
    run = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True)
    assert (run.stdout, run.stderr) == ("wcsim.agents.envs.wheelchair_env:WheelchairEnv\n", "")
