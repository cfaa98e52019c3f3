"""What travels: files by the hash of their content, kept once by a node, the same there as here."""

from __future__ import annotations

import io
import shutil
import stat
import zipfile
from dataclasses import replace
from pathlib import Path

import pytest
import zstandard

from tests.support.cluster.workpieces import blunder, read_parcel, refuse
from wcsim.errors import ConfigError, TownError, WorkersError
from wcsim.server.workers import cluster_node
from wcsim.server.workers.cluster_node import Fetch, SentParcel, do_work
from wcsim.server.workers.machines import Parcel, Work, WorkEnd


@pytest.fixture
def parcel(tmp_path: Path) -> Parcel:
    folder = tmp_path / "corner"
    folder.mkdir()
    for name in ("a.net.xml", "b.rou.xml", "secret.txt"):
        (folder / name).write_text(name)
    return Parcel(address=str(folder), folder=folder, names=("a.net.xml", "b.rou.xml"), kept=True)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache" / "wcsim"


def done(parcel: Parcel, fetch: Fetch, call=read_parcel) -> WorkEnd:
    one = SentParcel(parcel=parcel, digest=cluster_node.digest_of(parcel.folder, parcel.names), ref=("r",))
    return do_work("here/1", Work(key="a/1", call=call, piece=parcel.address), (one,), fetch)


def test_a_town_is_fetched_once_and_again_when_it_was_changed(parcel, cache):
    fetched = []

    def fetch(ref: str) -> bytes:
        fetched.append(ref)
        return cluster_node.packed(parcel)

    first = done(parcel, fetch)
    where, *texts = first.data.decode().splitlines()
    assert texts == ["a.net.xml", "b.rou.xml"] and Path(where).name == "corner"
    assert Path(where).is_relative_to(cache / "parcels")
    again = done(parcel, fetch)
    assert (
        again.data == first.data
        and again.facts["fetched_bytes"] == 0 < first.facts["fetched_bytes"]
        and len(fetched) == 1
    )
    (Path(where) / "a.net.xml").write_text("spoilt")
    assert done(parcel, fetch).data == first.data and len(fetched) == 2


def test_one_content_under_two_names_is_kept_under_both(parcel, tmp_path):
    other = tmp_path / "another"
    shutil.copytree(parcel.folder, other)
    both = (parcel, replace(parcel, address=str(other), folder=other))
    fetched, places = [], []
    for one in (*both, *both):

        def fetch(ref: str, one: Parcel = one) -> bytes:
            fetched.append(one.folder.name)
            return cluster_node.packed(one)

        places.append(Path(done(one, fetch).data.decode().splitlines()[0]))
    assert fetched == ["corner", "another"]
    assert [place.name for place in places] == ["corner", "another"] * 2
    assert all(place.is_dir() for place in places)


def test_a_network_is_there_for_its_piece_alone(parcel):
    loose = Parcel(address=parcel.address, folder=parcel.folder, names=parcel.names)
    reply = done(loose, lambda ref: cluster_node.packed(loose))
    assert not Path(reply.data.decode().splitlines()[0]).exists()


@pytest.mark.parametrize("name", ["../x", "danger/../../x", "/x"])
def test_a_name_that_leads_elsewhere_leads_nowhere(tmp_path, name):
    folder = tmp_path / "a" / "b"
    folder.mkdir(parents=True)
    cluster_node._unpack(packed_as(zipfile.ZipInfo(name), b"here"), folder)
    (written,) = (path for path in tmp_path.rglob("*") if path.is_file())
    assert written.is_relative_to(folder) and not Path("/x").exists()


def test_a_link_becomes_a_file(tmp_path):
    link = zipfile.ZipInfo("danger")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    cluster_node._unpack(packed_as(link, b"/"), tmp_path)
    assert not (tmp_path / "danger").is_symlink() and (tmp_path / "danger").read_bytes() == b"/"


def packed_as(info: zipfile.ZipInfo, data: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as held:
        held.writestr(info, data)
    return zstandard.compress(out.getvalue())


def test_a_parcel_that_would_be_too_large_is_refused_before_it_is(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster_node, "MOST_BYTES", 50)
    with pytest.raises(ValueError, match="more than 100 bytes"):
        cluster_node._unpack(zstandard.compress(bytes(1 << 20)), tmp_path)


def test_too_much_is_not_sent(parcel, monkeypatch):
    monkeypatch.setattr(cluster_node, "MOST_BYTES", 3)
    with pytest.raises(ConfigError, match="--cluster"):
        cluster_node.packed(parcel)


def test_a_node_tells_what_the_user_can_mend_from_what_only_another_node_can(parcel, monkeypatch):
    def fetch(ref: str) -> bytes:
        return cluster_node.packed(parcel)

    assert isinstance(done(parcel, fetch, refuse).error, TownError)
    with pytest.raises(WorkersError, match=r"a/1 failed on here/1: ZeroDivisionError.*see Ray's log"):
        raise done(parcel, fetch, blunder).error

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cluster_node, "_received", full)
    assert "No space" in done(parcel, fetch).lost
