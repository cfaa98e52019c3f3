"""docs/settings.md is made from the models, and holds every key with what it means."""

import pytest
from pydantic import BaseModel, Field

from tools import settings_page
from wcsim.config import RunConfig

SECTIONS = dict(settings_page.sections())
FILES = dict(settings_page.file_sections())


def leaves(data, before=()):
    """Dotted names of all plain values of a configuration; items of a list as if there were one."""
    if isinstance(data, dict) and data:
        return {name for key, value in data.items() for name in leaves(value, (*before, key))}
    if isinstance(data, (list, tuple)) and data and isinstance(data[0], dict):
        return {name for value in data for name in leaves(value, before)}
    return {".".join(before)}


def test_every_key_of_a_configuration_is_on_the_page():
    known = {f"{name.strip('[]')}.{key}" for name, model in SECTIONS.items() for key, *_ in settings_page.keys(model)}
    told = RunConfig(cameras=({"noise": "typical"},), sensors={"odometry": "typical"}).model_dump(mode="json")
    assert leaves(told) <= known
    assert "learn.phase1" in known and "danger.width" in known


@pytest.mark.parametrize("name", {**SECTIONS, **FILES})
def test_every_key_has_a_meaning(name):
    model = {**SECTIONS, **FILES}[name]
    assert [key for key, _, said in settings_page.keys(model) if not said] == [], "say it in a comment on its line"


def test_a_row_tells_type_bounds_default_and_meaning():
    class Some(BaseModel):
        """A table."""

        share: float = Field(default=0.5, ge=0.0, lt=1.0, description="of all | of it")

    text = settings_page._section("[some]", Some)
    assert text.splitlines()[-1] == "| `share` | number | ≥ 0, < 1 | `0.5` | of all \\| of it |"
    page = settings_page.page()
    assert '| `head` | `residual`, `plain`, `danger` |  | `"residual"` |' in page
    assert "## `[[cameras]]`" in page and "## `[cameras.noise.depth]`" in page
