"""Scene files in, scenes out: `load` and `read_nodes`."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..scene.nodes import Node
from .encodings import detect_format
from .errors import SceneFileError
from .limits import as_path, read_bounded
from .notes import ReadNotes
from .x3d_reader import read_x3d
from .x3d_source import X3DSource

if TYPE_CHECKING:
    from ..scene import Scene


@dataclasses.dataclass(frozen=True, eq=False)
class ReadScene:
    """The nodes of a file, and what of it could not be taken as it stands."""

    children: tuple[Node, ...]
    notes: ReadNotes
    source: X3DSource | None
    """What writing back into the file needs; None for formats other than X3D."""


def read_nodes(path: str | Path) -> ReadScene:
    """Read the nodes of a scene file: X3D (XML encoding), glb, obj with its mtl, ply, stl.

    The format is told by the content, not the name. Nothing outside the file's folder is opened. What jaxlight does
    not know is skipped with one SceneFileWarning a file, which counts and names it.

    Raises:
        SceneFileError: the file cannot be read, or is not what it should be; says where and why.
    """
    path = as_path("read_nodes: path", path)
    read = _read(path)
    read.notes.warn(path, stacklevel=2)
    return read


def load(path: str | Path, *, dtype: Any = None) -> Scene:
    """Read a scene file: as `read_nodes`, then `Scene.from_nodes`.

    Args:
        path: X3D (XML encoding), glb, obj with its mtl, ply or stl.
        dtype: type of the scene's numbers, as in `Scene.from_nodes`.

    Returns:
        The scene, with the nodes that it came from in its document.

    Raises:
        SceneFileError: the file cannot be read, or is not what it should be; says where and why.
        ValueError: another type; no path.
    """
    from ..scene import Scene
    from ..scene.fields import float_type
    from ..scene.flatten import MAX_PLACED, TOO_MANY_PLACED

    dtype = float_type("load: dtype", dtype)
    path = as_path("load: path", path)
    read = _read(path)
    if _placed(read.children) > MAX_PLACED:  # counted first: to place them takes long
        raise SceneFileError(path, None, TOO_MANY_PLACED)
    try:
        scene = Scene.from_nodes(read.children, dtype=dtype)
    except ValueError as error:
        raise SceneFileError(path, None, str(error)) from None
    read.notes.warn(path, stacklevel=2)
    document = dataclasses.replace(scene.document, source=read.source)
    return dataclasses.replace(scene, document=document)


def _placed(children: tuple[Node, ...]) -> int:
    """How many nodes the scene places: those that stand in groups, each as often as it is used."""

    from ..scene.flatten import shown_below

    counts: dict[Node, int] = {}
    waiting = list(children)
    while waiting:
        below = shown_below(waiting[-1])
        unknown = [node for node in below if node not in counts]
        waiting.extend(unknown)
        if not unknown:
            counts[waiting.pop()] = 1 + sum(counts[node] for node in below)
    return sum(counts[node] for node in children)


def _read(path: Path) -> ReadScene:
    data = read_bounded(path)
    file_format = detect_format(path, data)
    if file_format == "x3d":
        return ReadScene(*read_x3d(path, data))
    from .meshes import read_mesh  # trimesh is only loaded for meshes

    children, notes = read_mesh(path, data, file_format)
    return ReadScene(children, notes, None)
