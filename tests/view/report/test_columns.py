"""What the columns of a test show."""

from tests.view.report.results import record
from wcsim.agents.evaluation.suite.rows import row_of
from wcsim.view.report.columns import LOOK


def test_arrivals_are_nothing_where_no_episode_is_an_attempt_to_arrive():
    (arrivals,) = (column for column in LOOK if column.key == "arrivals")
    drawn, sent = ([record(0, part=part, route_m=0.0)] for part in ("Helsinki, ataxic user", "free"))
    assert arrivals.value(row_of("follow", "", drawn, ())) is None
    assert (
        arrivals.value(row_of("follow", "", sent, ())) == arrivals.value(row_of("follow", "", [*drawn, *sent], ())) == 1
    )
