"""What a recording says of the versions that it holds for."""

import pytest

from wcsim.log import fingerprint as here
from wcsim.log.fingerprint import make_engine_fingerprint, make_software_fingerprint


@pytest.mark.parametrize("package", ["wcsim", "libsumo", "pybullet", "numpy", "numba", "shapely", "networkx"])
def test_another_version_of_anything_that_computes_is_another_fingerprint(package, monkeypatch):
    told, known = make_software_fingerprint(), here.read_package_version
    monkeypatch.setattr(here, "read_package_version", lambda name: "0" if name == package else known(name))
    assert make_software_fingerprint() != told and f"{package}-0" in make_software_fingerprint().split()


def test_golden_traces_outlive_versions_of_wcsim(monkeypatch):
    told, known = make_engine_fingerprint(), here.read_package_version
    monkeypatch.setattr(here, "read_package_version", lambda name: "0" if name == "wcsim" else known(name))
    assert make_engine_fingerprint() == told
