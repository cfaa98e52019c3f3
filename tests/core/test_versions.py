"""Versions of packages, and of PyBullet under either of its names."""

from importlib import metadata

import pytest

from wcsim.core.versions import version_of


@pytest.mark.parametrize(
    ("installed", "told"),
    [
        ({"pybullet": "3.2.7"}, "3.2.7"),
        ({"pybullet-arm64": "3.2.8"}, "3.2.7"),
        ({"pybullet-arm64": "3.2.9"}, "pybullet-arm64-3.2.9"),
        ({}, ""),
    ],
)
def test_the_fork_counts_as_the_release_whose_bytes_it_gives(installed, told, monkeypatch):
    def version(name):
        if name in installed:
            return installed[name]
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(metadata, "version", version)
    assert version_of("pybullet") == told and version_of("numpy") == ""
