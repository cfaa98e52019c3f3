"""A film of a scene: the camera of its first wheelchair beside a map."""

from __future__ import annotations

from pathlib import Path

from wcsim.config import CameraConfig
from wcsim.scenes.run import open_scene, play
from wcsim.view.map import MapView, map_view
from wcsim.view.pictures import captioned
from wcsim.view.video import VideoWriter, side_by_side

CAMERA = CameraConfig(width_px=480, height_px=360, rgb=True)
MAP_SPAN_M = 40.0


def film_scene(folder: Path, path: Path) -> None:
    """Run a scene and write it as a video (.webm). Raises TownError or ConfigError as the parts do."""
    with open_scene(folder, (CAMERA,)) as (world, scene):
        chart = MapView(world.street.mesh, CAMERA.height_px, MAP_SPAN_M)
        size = (CAMERA.width_px + CAMERA.height_px, CAMERA.height_px)
        with VideoWriter(path, 1.0 / world.config.world.tick_s, size) as video:
            for snapshot, _ in play(world, scene):
                frame = snapshot.clients[0].sensors.cameras[0]
                if frame.rgb is not None:
                    told = captioned(frame.rgb, f"{scene.name} {snapshot.time_s:.1f} s")
                    video.write(side_by_side(told, map_view(chart, world)))
