"""A test's result, as its folder holds it."""

import pytest

from tests.view.report.results import write_result
from wcsim.agents.evaluation.suite.result_files import read_result


@pytest.fixture
def result(tmp_path):
    write_result(tmp_path)
    return read_result(tmp_path)
