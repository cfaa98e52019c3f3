"""The table of docs/chair.md holds every field of a plant's file, with its unit and the bounds that the model has."""

import re
from typing import get_origin

from tests.support.tracked import ROOT
from tools import settings_page
from wcsim.config import ChairConfig
from wcsim.config.base import _UNITS
from wcsim.config.plant import PlantFile, list_plants, read_plant

PAGE = (ROOT / "docs" / "chair.md").read_text()


def fields(model=PlantFile, before=""):
    """Of every plain value of the file, its dotted name and how its row of the table begins."""
    for name, field in model.model_fields.items():
        inner = settings_page._model_of(field)
        if inner is ChairConfig:  # docs/settings.md has its fields
            continue
        if inner is not None:
            many = get_origin(field.annotation) is tuple or before + name in ("casters", "antitips", "frame.boxes")
            yield from fields(inner, f"{before}{name}{'.*' if many else ''}.")
            continue
        unit = _UNITS.get(name.rpartition("_")[2], "")
        yield before + name, f"| `{before}{name}` | {unit} | {settings_page._bounds(field)} |"


def test_every_field_stands_in_the_table_with_unit_and_bounds():
    lines = PAGE.splitlines()
    missing = [row for _, row in fields() if not any(line.startswith(row + " ") for line in lines)]
    assert missing == [], "write them into docs/chair.md"


def test_the_table_has_no_field_that_the_file_lacks():
    table = PAGE.partition("### Every field")[2].partition("###")[0]
    told = re.findall(r"^\| `([\w.*]+)` \|", table, re.MULTILINE)
    assert sorted(told) == sorted(name for name, _ in fields())


def test_the_example_is_a_plant_of_another_kind():
    plant = read_plant(str(ROOT / "examples" / "fwd.toml"))
    assert max(pair.swivel_x_m for pair in plant.casters) < 0.0 and plant.mass.com_x_m < 0.0
    assert all(max(pair.swivel_x_m for pair in read_plant(name).casters) > 0.0 for name in list_plants())
