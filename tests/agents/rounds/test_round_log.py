from pathlib import Path

import pytest

from wcsim.agents.runs.metrics import append_round_metrics, has_metrics_per_round, read_round_metrics
from wcsim.errors import PolicyError

FIRST = (0, 2000, 1500, 0.25, 4, 300, 1, 500, 2, 50, 0.5, 1.25, 2.5)
SECOND = (1, 4500, 2500, 0.3, 3, 0, 0, 9, 1, 100, 0.25, 0.0, 3.0)


def test_rows_come_back_and_a_round_that_is_done_again_stands_once(tmp_path: Path) -> None:
    path = tmp_path / "metrics.csv"
    for row in (FIRST, (1, 9999, *SECOND[2:]), SECOND):
        append_round_metrics(path, row)
    first, second = read_round_metrics(path)
    assert has_metrics_per_round(path)
    assert (first.steps, first.new_steps, first.tight_share, first.wait_s) == (2000, 1500, 0.25, 1.25)
    assert (second.round, second.steps, second.crashes, second.updates, second.learn_s) == (1, 4500, 3, 100, 3.0)
    assert (first.network_steps, first.network_crashes, first.user_steps, first.user_crashes) == (300, 1, 500, 2)


@pytest.mark.parametrize(
    "row",
    [
        "0,1",
        "0,x" + ",0" * 11,
        "1,2,2" + ",0" * 10,
        "0,-5" + ",0" * 11,
        "0,nan" + ",0" * 11,
        "9" * 5000 + ",0" * 12,
    ],
)
def test_a_damaged_row_is_refused(tmp_path: Path, row: str) -> None:
    path = tmp_path / "metrics.csv"
    append_round_metrics(path, FIRST)
    path.write_text(path.read_text().splitlines()[0] + f"\n{row}\n")
    with pytest.raises(PolicyError, match="is damaged"):
        read_round_metrics(path)


def test_another_log_is_none_of_rounds(tmp_path: Path) -> None:
    path = tmp_path / "metrics.csv"
    path.write_text("step,episode\n")
    assert not has_metrics_per_round(path)
    with pytest.raises(PolicyError, match="expected those of this version"):
        read_round_metrics(path)


def test_a_cell_that_no_table_has_is_refused(tmp_path: Path) -> None:
    (tmp_path / "metrics.csv").write_text("x" * 200_000)
    with pytest.raises(PolicyError, match="has columns none"):
        read_round_metrics(tmp_path / "metrics.csv")


def test_large_counts_lose_no_digit(tmp_path: Path) -> None:
    append_round_metrics(
        tmp_path / "metrics.csv", (0, 1_234_567, 1_234_567, 0.25, 4, 0, 0, 0, 0, 7_654_321, 0.5, 1.25, 2.5)
    )
    (row,) = read_round_metrics(tmp_path / "metrics.csv")
    assert (row.steps, row.updates) == (1_234_567, 7_654_321)
