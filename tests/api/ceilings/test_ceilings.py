"""Every number of the tree is within its ceiling, and each counter sees what it is to count."""

from dataclasses import replace

import pytest

from tests.api.ceilings import measures, table

# Pages are templates and no code; one example writes a dataset of the field; what only measures left the package; a new
# line of code brings a line of tests.
RAISED = (
    "templates: lines",
    "examples: tokens",
    "benchmarks: tokens",
    "tests: tokens",
    "JavaScript: lines",
    "HTML and CSS: lines",
)


@pytest.fixture(scope="module")
def now() -> dict[str, float]:
    return table.counted()


def test_no_ceiling_is_broken_and_none_has_room(now: dict[str, float]) -> None:
    assert table.faults(now) == []


@pytest.mark.parametrize("row", table.ROWS, ids=lambda row: row.name)
def test_a_number_that_grows_or_falls_is_noticed(row: table.Row, now: dict[str, float]) -> None:
    low = replace(row, ceiling=now[row.name] - 1)
    high = replace(row, ceiling=1.5 * now[row.name] + 2)
    grown, fallen = table.faults(now, (low, high))
    assert grown.startswith(f"{row.name}: ") and "expected at most" in grown
    assert fallen.startswith(f"{row.name}: ") and "lower it" in fallen
    assert row.ceiling <= row.first or row.name in RAISED


def test_tokens_are_counted_and_neither_docstrings_nor_joined_lines_matter() -> None:
    plain = '"""Doc\nstring."""\n\n# Why.\n# And why.\nx = 1  # unit\ny = 2\n\n\ndef f() -> None:\n    """Doc."""\n'
    assert measures._tokens(f"{plain}    # Here.\n") == (13, 2)
    assert measures._tokens("x = 1; y = 2\n")[0] == 7
    assert measures._tokens("text = '''a\nb'''\n")[0] == 3  # a string that has a name is code


@pytest.mark.parametrize(
    "code, ticks, starts",
    [
        ("world.tick(1)", True, False),
        ("self._world.tick(1)", True, False),
        ("session.tick()", False, False),
        ("subprocess.Popen(words)", False, True),
        ("ProcessPoolExecutor(2)", False, True),
        ("psutil.Process()", False, False),
        ("os.fork()", False, True),
        ("shutil.run()", False, False),
    ],
)
def test_loops_and_processes_are_seen(code: str, ticks: bool, starts: bool) -> None:
    assert measures._calls(code, measures._ticks_a_world) is ticks
    assert measures._calls(code, measures._starts_a_process) is starts


def test_imports_within_a_function_and_of_a_package_are_seen() -> None:
    code = "import numpy\nfrom wcsim.agents import policies\n\n\ndef f():\n    import wcsim.bridge.world\n"
    assert measures._imported(code) == {"agents", "agents.policies", "bridge.world"}
    assert measures._is_below("agents.policies.dwa", ("agents.policies",))
    assert not measures._is_below("agents.policy_api", ("agents.policies",))


@pytest.mark.parametrize("border", measures.BORDERS)
def test_both_sides_of_a_border_are_there(border: str) -> None:
    names = [name for name, _ in measures._sources("wcsim")]
    sources, targets, excepted = measures.BORDERS[border]
    assert all(any(measures._is_below(name, (room,)) for name in names) for room in (*sources, *targets, *excepted))


CODE = """
FIRST = 1

def go(x):
    return _twice(_once(x)) + _twice(x) + self._own(x)

def _once(x):
    return x

def _twice(x):
    return x

@compile_exact_kernel
def _fast(x):
    return x

def _again(x):
    return _again(x - 1)

class C:
    def _own(self, x):
        return map(_passed, [_fast(x)])

def _passed(x):
    return x

TABLE = {"go": go}
"""


def test_private_functions_that_one_call_names_are_seen_and_no_others() -> None:
    assert sorted(measures._once(CODE)) == ["_once", "_own"]


def test_a_constant_is_late_unless_it_is_made_of_what_stands_before_it() -> None:
    assert not measures._has_late(CODE)
    assert measures._has_late(f"{CODE}\nLAST = FIRST\n")


def test_ideas_are_found_where_they_are_known_to_be() -> None:
    assert "log.records" in measures.formats()
    assert "supervisor.kpi:plus" in measures.meters()
    assert measures.learners() == ["agents.danger.learner", "agents.learning.seqdqn"]
    assert {"wcsim/bridge", "wcsim/agents/danger"} < set(measures.rooms())
