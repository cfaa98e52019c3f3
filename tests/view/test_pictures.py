"""Pictures, maps and videos for people."""

import cv2
import numpy as np
import pytest

from tests.physics.renderer.render_oracle import actor
from tests.support.one_process import files_of_at_most
from tests.support.plants import plant_state
from tests.support.samples import USUAL_OUTLINE, straight_route, strip_street
from tests.view.films import frames_of
from wcsim.core.files import write_file_atomically
from wcsim.errors import ConfigError, DiskFullError
from wcsim.physics.renderer.instances import chair_pose
from wcsim.supervisor.palette import COLOURS
from wcsim.types import ActorKind, ClassId, Route
from wcsim.view.filming import _triptych
from wcsim.view.map import ROUTE_RGB, MapView
from wcsim.view.pictures import captioned, class_colours, depth_colours, open_video, write_png


def test_every_class_has_a_colour_of_its_own():
    named = set(COLOURS)
    assert named == set(ClassId)
    assert len(set(COLOURS.values())) >= len(COLOURS) - 1  # static things are black in Cityscapes, as void is
    ids = np.array([[ClassId.ROAD, ClassId.SKY], [ClassId.VOID, 200]], np.uint8)
    assert class_colours(ids).tolist() == [[[128, 64, 128], [70, 130, 180]], [[0, 0, 0], [0, 0, 0]]]


def test_depth_goes_from_red_to_blue_and_ends_in_black():
    colours = depth_colours(np.array([[0.4, 4.0, 30.0, 40.0]], np.float32), range_m=40.0)[0].astype(int)
    assert colours[0, 0] > colours[0, 2] and colours[2, 2] > colours[2, 0]
    assert colours[3].tolist() == [0, 0, 0]
    assert depth_colours(np.zeros((1, 1), np.float32), range_m=40.0)[0, 0].tolist() == [255, 255, 255]


def test_a_triptych_shows_three_panels_of_one_size():
    rgb = np.full((60, 80, 3), 90, np.uint8)
    classes, depth = np.full((60, 80), ClassId.ROAD, np.uint8), np.full((60, 80), 3.0, np.float32)
    image = _triptych(rgb, classes, depth)
    assert image.shape == (60, 240, 3) and image.dtype == np.uint8
    assert image[50, 70].tolist() == [90, 90, 90]
    assert image[50, 150].tolist() == [128, 64, 128]
    assert (rgb == 90).all()  # captions are written on a copy


def test_a_caption_can_be_seen():
    plain = np.full((60, 200, 3), 128, np.uint8)
    image = captioned(plain, "camera")
    assert image[:25].std() > 10 and (image[30:] == 128).all()


def test_png_is_written_whole_and_read_back(tmp_path):
    image = np.random.default_rng(0).integers(0, 255, (20, 30, 3), dtype=np.uint8)
    path = tmp_path / "a.png"
    write_png(path, image)
    assert np.array_equal(cv2.imread(str(path))[..., ::-1], image)
    assert [item.name for item in tmp_path.iterdir()] == ["a.png"]
    with pytest.raises(DiskFullError, match="choose another place"):
        write_png(path / "a.png", image)


def test_a_video_plays_back_what_was_written(tmp_path):
    path = tmp_path / "a.webm"
    with open_video(path, 0.1) as write:  # an odd width is padded
        for level in range(0, 200, 10):
            write(np.full((48, 65, 3), (level, 0, 0), np.uint8))
        assert not path.exists()
    assert path.read_bytes()[:4] == b"\x1aE\xdf\xa3"  # EBML, the start of every WebM file
    levels = [float(frame[..., 2].mean()) for frame in frames_of(path)]
    assert len(levels) == 20 and levels[-1] - levels[0] > 150
    assert [item.name for item in tmp_path.iterdir()] == ["a.webm"]


def test_a_failed_video_leaves_nothing_behind(tmp_path):
    with pytest.raises(RuntimeError), open_video(tmp_path / "a.webm", 0.1) as write:
        write(np.zeros((48, 64, 3), np.uint8))
        raise RuntimeError
    assert not list(tmp_path.iterdir())


def test_a_video_that_was_cut_short_is_none(tmp_path):
    noise = np.random.default_rng(0).integers(0, 256, (240, 320, 3), np.uint8)
    with files_of_at_most(1 << 15):
        with (
            pytest.raises(DiskFullError, match=r"/a\.webm: .*make room"),
            open_video(tmp_path / "a.webm", 0.1) as write,
        ):
            for _ in range(20):
                write(noise)
        with (
            pytest.raises(DiskFullError, match=r"/a\.png: .*make room"),
            write_file_atomically(tmp_path / "a.png") as part,
        ):
            write_png(part, noise)
    assert not list(tmp_path.iterdir())


def test_a_video_says_what_it_cannot_do(tmp_path):
    with pytest.raises(ConfigError, match=r"\.webm"), open_video(tmp_path / "a.mp4", 0.1):
        pass
    with pytest.raises(ConfigError, match="folder"), open_video(tmp_path / "nowhere" / "a.webm", 0.1):
        pass
    with open_video(tmp_path / "b.webm", 0.1) as write:
        write(np.zeros((48, 64, 3), np.uint8))
        with pytest.raises(ConfigError, match="expected"):
            write(np.zeros((64, 48, 3), np.uint8))


def test_the_map_is_true_to_scale_with_north_up():
    view = MapView(strip_street().mesh, size_px=400, span_m=40.0)  # 10 pixels a metre
    car = actor(ActorKind.CAR, 10.0, -2.0, 0.0, 0.0, size=(6.0, 2.0, 1.5))
    chair = chair_pose(0, plant_state(4.0, 5.5, 0.12), USUAL_OUTLINE)
    centre = np.array([10.0, 0.0, 0.0])
    empty = view.draw(centre, ()).astype(int)
    changed = np.abs(view.draw(centre, (car,)).astype(int) - empty).sum(axis=2) > 30
    rows, columns = np.nonzero(changed)
    assert (columns.min() + columns.max()) / 2 == pytest.approx(199.5, abs=2)  # x = 10 is the middle
    assert (rows.min() + rows.max()) / 2 == pytest.approx(219.5, abs=2)  # y = -2 is 20 pixels below it
    assert np.ptp(columns) == pytest.approx(60, abs=3) and np.ptp(rows) == pytest.approx(20, abs=3)
    full = view.draw(centre, (car,), [chair], straight_route())
    assert (np.abs(full[145, 300].astype(int) - ROUTE_RGB) < 40).all()  # the route runs along y = 5.5
    box = full[142:149, 137:149].astype(int)
    assert ((box[..., 0] > 200) & (box[..., 1] > 180) & (box[..., 2] < 120)).any()  # the chair is yellow


def luminance(rgb):
    """Of WCAG 2."""
    share = np.asarray(rgb) / 255.0
    return np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4) @ (0.2126, 0.7152, 0.0722)


def contrast(one, other):
    dark, light = sorted((luminance(one), luminance(other)))
    return (light + 0.05) / (dark + 0.05)


def test_roofs_stand_out_from_roads_and_the_way_from_grass_on_a_map():
    view = MapView(strip_street().mesh, size_px=400, span_m=40.0)  # 10 pixels a metre
    points_m = np.column_stack([np.arange(40.0, 80.0), np.full(40, 8.0)])
    way = Route(points_W_m=points_m, arc_m=np.arange(40.0), edge_index=np.zeros(40, np.int32))
    picture = view.draw(np.array([60.0, 6.0, 0.0]), (), (), way)
    roof, road, grass, line = picture[120, 200], picture[240, 200], picture[175, 50], picture[180, 50]
    assert (roof != line).any() and contrast(roof, road) > 1.5
    assert contrast(line, grass) > 3.0
