"""A scene as a file."""

from __future__ import annotations

import numpy as np

from app.scene import shapes
from app.scene.build import add_robot, add_run
from app.scene.data import SceneData
from app.scene.servers import LocalServer
from app.scene.style import slug


def export_html(data: SceneData, theme: str) -> str:
    """The scene as one self-contained page, robots at the end of their paths; blocking, a second or so."""
    server = LocalServer()
    try:
        sizes = add_run(server, data, theme)
        for path in data.paths:
            frame = add_robot(server.scene, f"/world/robots/{slug(path.method)}", path, data, sizes, theme, leads=True)
            x, y, theta = path.pose_at(data.t1)
            if np.isfinite((x, y)).all():
                frame.position = (x, y, 0.0)
            if np.isfinite(theta):
                frame.wxyz = shapes.yaw(theta)
        return server.get_scene_serializer().as_html(dark_mode=theme == "dark")
    finally:
        server.stop()
