"""The camera that a command line names."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from jaxlight import Camera, Scene


def camera_of(scene: Scene, viewpoint: str) -> Camera:
    """The camera of a Viewpoint, given by its DEF name or number; "": the one that the scene is first seen with.

    Raises:
        ValueError: no such Viewpoint; lists those that exist.
    """
    from jaxlight import Camera

    if not viewpoint:
        return Camera.default(scene)
    placed = scene.document.viewpoints
    names = [one.node.name for one in placed]
    if viewpoint in names:
        return Camera.from_viewpoint(placed[names.index(viewpoint)])
    if viewpoint.isdecimal() and int(viewpoint) < len(placed):
        return Camera.from_viewpoint(placed[int(viewpoint)])
    there = ", ".join(name or str(row) for row, name in enumerate(names)) or "none"
    raise ValueError(f"the scene has no Viewpoint {viewpoint!r}; it has {there}")
