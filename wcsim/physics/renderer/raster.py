"""The default renderer: a span rasteriser on the CPU, depth and class in one pass, colours on demand."""

from __future__ import annotations

import numpy as np

from wcsim.physics.buffers import Images, new_images
from wcsim.physics.renderer import kernels, shading
from wcsim.physics.renderer.base import Pinhole, check_images
from wcsim.physics.renderer.geometry import GeometryStore
from wcsim.physics.renderer.instances import Instances, actor_instances
from wcsim.physics.renderer.models.paint import AMBIENT, DIFFUSE, HORIZON_RGB, SUN_W, ZENITH_RGB, paint_table
from wcsim.types import F64, Bool


class RasterRenderer:
    """Draws a `GeometryStore` with the compiled kernels; releases the GIL, holds nothing between pictures.

    One object may draw from several threads at once, into buffers of their own.
    """

    def __init__(self, store: GeometryStore, cull: bool = True) -> None:
        """`cull=False` draws what is out of view too; it is for tests."""
        self._cull = cull
        self._street = kernels.StreetArrays(
            vertices=store.vertices_W_m,
            faces=store.faces,
            face_class=store.face_class,
            chunk_vertices=store.chunk_vertices,
            chunk_faces=store.chunk_faces,
            spheres=store.spheres_W_m,
            rgb=store.paint.rgb,
            pattern=store.paint.pattern,
            frame=store.paint.frame,
        )
        templates = store.templates
        self._models = kernels.ModelArrays(
            vertices=templates.vertices,
            faces=templates.faces,
            face_class=templates.face_class,
            face_paint=templates.face_paint,
            vertices_of=templates.vertices_of,
            faces_of=templates.faces_of,
            paints=paint_table(),
        )
        self._light = np.array([AMBIENT, DIFFUSE, *HORIZON_RGB, *ZENITH_RGB])

    def render(
        self, camera: Pinhole, T_CW: F64, instances: Instances, out: Images, shown: Bool | None = None
    ) -> None:
        """Draw into `out`; see `Renderer.render`."""
        check_images(camera, out)
        wordless = out.rgb is None and out.instance is None
        words = np.empty((0, 0) if wordless else out.class_id.shape, np.uint32)
        target, view = kernels.Target(out.depth_m, out.class_id, words), self._view(camera, T_CW)
        actors = instances.placed
        if shown is None:
            shown = np.ones(len(instances), np.bool_)
        if out.instance is not None:  # a word holds a row or a colour: who wants both has it drawn twice
            kernels.draw(self._street, self._models, actors, shown, view, self._cull, True, target)
            shading.tell_apart(words, out.class_id, out.instance)
        if out.instance is None or out.rgb is not None:
            kernels.draw(self._street, self._models, actors, shown, view, self._cull, False, target)
        if out.rgb is not None:
            shading.colour(self._street, view, _inverse(view.T_CW), out.depth_m, words, out.rgb)

    def _view(self, camera: Pinhole, T_CW: F64) -> kernels.View:
        T_CW = np.ascontiguousarray(T_CW, np.float64)
        return kernels.View(
            T_CW=T_CW,
            focal_px=float(camera.focal_px),
            near_m=float(camera.near_m),
            range_m=float(camera.range_m),
            sun_C=T_CW[:, :3] @ SUN_W,
            light=self._light,
        )


def warm_up(renderer: RasterRenderer) -> None:
    """Compile the kernels now (seconds on a fresh machine, then a fraction of one) instead of at the first picture."""
    camera = Pinhole(width_px=16, height_px=12, focal_px=8.0, near_m=0.1, range_m=40.0)
    T_CW = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.0], [1.0, 0.0, 0.0, 0.0]])
    renderer.render(camera, T_CW, actor_instances(()), new_images(16, 12, rgb=True, instance=True))


def _inverse(T_CW: F64) -> F64:
    """Camera to world, (3, 4), of a rigid T_CW."""
    T_WC = np.empty((3, 4))
    R_WC = T_CW[:, :3].T
    T_WC[:, :3], T_WC[:, 3] = R_WC, -R_WC @ T_CW[:, 3]
    return T_WC
