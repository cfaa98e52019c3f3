from pathlib import Path

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.warp import transform

from wcsim.errors import TownError
from wcsim.towns.ground.relief import steepest_grade
from wcsim.towns.importing.elevation import (
    Dem,
    Heights,
    _heights_at,
    _own_projections,
    _scaled,
    _smoothed,
    lift_net,
    make_dem,
)
from wcsim.towns.importing.importer import ImportOrder, import_town
from wcsim.towns.osm.read import Box
from wcsim.towns.scenario.town import Town
from wcsim.towns.sumo.net import read_net
from wcsim.towns.sumo.xml_io import read_bytes

BOX = Box(7.4175, 43.7368, 7.4249, 43.7422)


def write_tiff(path: Path, crs: str | None, *, hole: bool = False, width: int = 240) -> Path:
    """Land that rises 5 cm a metre to the east of UTM zone 32's 370 km, in cells of 10 m."""
    x_m = 371_500.0 + 10.0 * np.arange(width)
    height_m = np.broadcast_to(0.05 * (x_m - 371_500.0), (240, width)).astype(np.float32).copy()
    if hole:
        height_m[100:130, 100:130] = -9999.0
    place = Affine(10.0, 0.0, 371_495.0, 0.0, -10.0, 4_845_700.0)
    profile = {"driver": "GTiff", "width": width, "height": 240, "count": 1, "dtype": "float32", "transform": place}
    with _own_projections(), rasterio.open(path, "w", crs=crs, nodata=-9999.0, **profile) as file:
        file.write(height_m, 1)
    return path


@pytest.mark.parametrize("hole", [False, True])
def test_a_geotiff_in_metres_is_read_where_it_lies(tmp_path: Path, hole: bool) -> None:
    path = write_tiff(tmp_path / "a.tif", "EPSG:32632", hole=hole)
    dem = make_dem(Heights(dem=path), BOX, 0)
    assert dem is not None and np.isfinite(dem.height_m).all()
    places = np.array([[7.4180, 43.7370], [7.4240, 43.7420], [7.4210, 43.7400]])
    x_m = np.array(transform("EPSG:4326", "EPSG:32632", *places.T)[0])
    assert _heights_at(dem, places) == pytest.approx(0.05 * (x_m - 371_500.0), abs=8.0 if hole else 0.1)


def test_what_cannot_be_used_is_said(tmp_path: Path) -> None:
    (tmp_path / "rubbish.tif").write_bytes(b"II*\0rubbish")
    cases = {
        "missing.tif": "cannot be read",
        "rubbish.tif": "cannot be read",
        write_tiff(tmp_path / "nowhere.tif", None).name: "no coordinate system",
        write_tiff(tmp_path / "narrow.tif", "EPSG:32632", width=20).name: "covers 7\\..*the town needs 7\\.",
    }
    for name, told in cases.items():
        with pytest.raises(TownError, match=told) as caught:
            make_dem(Heights(dem=tmp_path / name), BOX, 0)
        assert name in str(caught.value) and "\n" not in str(caught.value)


def test_only_a_geotiff_of_a_size_that_can_be_read_is_one(tmp_path: Path) -> None:
    sound = write_tiff(tmp_path / "sound.tif", "EPSG:32632")
    (tmp_path / "virtual.tif").write_text(
        f"""<VRTDataset rasterXSize="240" rasterYSize="240"><SRS>EPSG:32632</SRS>
        <GeoTransform>371495,10,0,4845700,0,-10</GeoTransform><VRTRasterBand dataType="Float32" band="1">
        <SimpleSource><SourceFilename>{sound}</SourceFilename><SourceBand>1</SourceBand></SimpleSource>
        </VRTRasterBand></VRTDataset>""",
    )
    place = Affine(1e-6, 0.0, 7.3, 0.0, -1e-6, 43.8)
    shape = {"width": 60_000, "height": 60_000, "count": 1, "dtype": "float32", "transform": place, "SPARSE_OK": True}
    with (
        _own_projections(),
        rasterio.open(tmp_path / "giant.tif", "w", driver="GTiff", crs="EPSG:4326", **shape) as file,
    ):
        file.update_tags(WCSIM_MAX_GRADE="0")
    shape |= {"width": 200, "height": 200, "count": 40}
    with _own_projections(), rasterio.open(tmp_path / "bands.tif", "w", driver="GTiff", crs="EPSG:4326", **shape):
        pass
    (tmp_path / "link.tif").symlink_to("/dev/zero")
    cases = {
        "virtual.tif": "does not begin as a TIFF file",
        "giant.tif": "60000 x 60000 cells in 1 bands",
        "bands.tif": "in 40 bands",
        "link.tif": "is not a regular file",
    }
    for name, told in cases.items():
        with pytest.raises(TownError, match=told):
            make_dem(Heights(dem=tmp_path / name), BOX, 0)


def test_what_lies_beside_a_geotiff_is_left_alone(tmp_path: Path) -> None:
    path = write_tiff(tmp_path / "a.tif", "EPSG:32632")
    wanted = make_dem(Heights(dem=path), BOX, 0)
    (tmp_path / "a.tif.aux.xml").write_text(
        '<PAMDataset><SRS>EPSG:4326</SRS><GeoTransform>0,1,0,0,0,-1</GeoTransform><PAMRasterBand band="1">'
        "<NoDataValue>5</NoDataValue></PAMRasterBand></PAMDataset>",
    )
    (tmp_path / "a.tfw").write_text("1\n0\n0\n-1\n0\n0\n")
    (tmp_path / "a.tif.ovr").write_bytes(b"II*\0 no overview")
    (tmp_path / "a.tif.msk").write_bytes(b"II*\0 no mask")
    found = make_dem(Heights(dem=path), BOX, 0)
    assert wanted is not None and found is not None and np.array_equal(found.height_m, wanted.height_m)


def test_a_hill_is_smooth_seeded_and_as_high_as_ordered() -> None:
    hills = [make_dem(Heights(hill_m=20.0), BOX, seed) for seed in (1, 1, 2)]
    first, same, other = (hill.height_m for hill in hills if hill is not None)
    assert np.ptp(first) == pytest.approx(20.0) and np.array_equal(first, same) and not np.array_equal(first, other)
    assert np.abs(np.diff(first, axis=0)).max() < 1.5
    assert make_dem(Heights(), BOX, 1) is None


def test_a_file_of_our_own_is_taken_as_it_is_only_where_and_as_gentle_as_it_was_made(tmp_path: Path) -> None:
    gentle = Heights(hill_m=20.0, max_grade=0.06)
    made = make_dem(gentle, BOX, 1)
    assert made is not None
    path = tmp_path / "own.dem.tif"
    made.write(gentle.max_grade, path)
    kept, steeper, gentler = (make_dem(Heights(dem=path, max_grade=g), BOX, 0) for g in (0.06, 0.1, 0.03))
    assert kept is not None and steeper is not None and gentler is not None
    assert kept.smooth and steeper.smooth and not gentler.smooth
    assert gentler.height_m == pytest.approx(made.height_m, abs=0.3)
    with pytest.raises(TownError, match="use a file that covers the town"):
        make_dem(Heights(dem=path), Box(24.93, 60.16, 24.94, 60.17), 0)


def test_smoothing_and_lowering_make_land_gentler() -> None:
    rough = Dem(height_m=np.random.Generator(np.random.Philox(3)).uniform(0, 30, (60, 60)), box=BOX)
    assert np.ptp(_smoothed(rough, 30.0).height_m) < 0.6 * np.ptp(rough.height_m)
    assert np.ptp(_scaled(rough, 0.1).height_m) == pytest.approx(0.1 * np.ptp(rough.height_m))


def test_every_point_of_a_net_lies_on_the_land(manhattan_town: Town, tmp_path: Path) -> None:
    path = tmp_path / "x.net.xml"
    path.write_bytes(read_bytes(manhattan_town.net))
    flat = read_net(path)
    box = Box.of((manhattan_town.folder / "osm" / "bbox").read_text())
    relief = Heights(hill_m=150.0, max_grade=0.08)
    dem = make_dem(relief, box, 5)
    assert dem is not None
    used = lift_net(path, dem, relief)
    net = read_net(path)
    assert 0.05 < steepest_grade(net) <= 0.0805
    ends = {}
    for edge in net.edges:
        for lane in edge.lanes:
            for k in (0, -1):
                ends.setdefault(tuple(np.round(lane.points_m[k], 1)), []).append(lane.z_m[k])
    assert max(np.ptp(heights_m) for heights_m in ends.values()) < 0.05, "lanes that meet, meet at one height"
    assert [edge.id for edge in net.edges] == [edge.id for edge in flat.edges]
    used.write(relief.max_grade, tmp_path / "x.dem.tif")
    stored = make_dem(Heights(dem=tmp_path / "x.dem.tif"), box, 0)
    assert stored is not None and stored.smooth and np.array_equal(stored.height_m, used.height_m)


def test_a_net_without_a_place_cannot_be_lifted(corner_town: Town, tmp_path: Path) -> None:
    path = tmp_path / "x.net.xml"
    path.write_bytes(read_bytes(corner_town.net))
    dem = make_dem(Heights(hill_m=5.0), BOX, 5)
    assert dem is not None
    with pytest.raises(TownError, match="no geographic projection"):
        lift_net(path, dem, Heights(hill_m=5.0))


def test_where_rasterio_is_missing_it_is_told_before_a_town_is_built(monkeypatch, tmp_path):
    monkeypatch.setattr("wcsim.errors.find_spec", lambda name: None)
    order = ImportOrder(map_file=tmp_path, name="x", split="test", out=tmp_path / "x", relief=Heights(hill_m=20.0))
    with pytest.raises(TownError, match=r"pip install 'wcsim\[dem\]'"):
        import_town(order)
