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


def test_a_cpu_that_is_told_as_an_older_one_is_another(monkeypatch):
    told = []
    for units in ("", " avx512f", " amx_tile"):
        cpu = f"vendor_id : Intel\ncpu family : 6\nmodel : 167\nflags : avx2{units}\n\n"
        monkeypatch.setattr(here.Path, "read_text", lambda *_, cpu=cpu, **__: cpu)
        told.append(make_engine_fingerprint())
    assert told[0] == told[1] != told[2] and "Intel-6-167-amx" in told[2].split()
