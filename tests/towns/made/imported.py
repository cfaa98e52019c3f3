"""A town that is imported from the text of an extract."""

from pathlib import Path

import pytest

from wcsim.towns.importing import demand
from wcsim.towns.importing.importer import ImportOrder, _Imported, import_town


def imported(osm: str, folder: Path) -> _Imported:
    """The test town `small` in a folder; its demand is tried for 20 s alone."""
    (folder / "small.osm").write_text(osm)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demand, "TRIAL_S", 20)
        return import_town(ImportOrder(map_file=folder / "small.osm", name="small", split="test", out=folder / "small"))
