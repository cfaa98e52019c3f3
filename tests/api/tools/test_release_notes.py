"""Notes of a release are its section of the changelog, and the version that is named has one."""

import tomllib

import pytest

from tests.support.tracked import ROOT
from tools.release_notes import notes

LOG = "# Changelog\n\n## 0.3.0 (2027-01-01)\n\n### New\n\n- a\n\n## 0.2.0\nb\n\n## 0.1.0 (2026-11-20)\n"


def test_notes_end_at_the_next_version():
    assert notes(LOG, "0.3.0") == "### New\n\n- a"
    assert notes(LOG, "0.2.0") == "b"


@pytest.mark.parametrize("version", ["0.1.0", "0.3", "1.0.0"])
def test_a_version_without_notes_is_refused(version):
    with pytest.raises(ValueError, match=f"no notes for '{version}'"):
        notes(LOG, version)


def test_the_changelog_has_notes_of_the_version_of_the_package():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert notes((ROOT / "CHANGELOG.md").read_text(), project["version"])
