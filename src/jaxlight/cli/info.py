"""`jaxlight info`: what a scene file holds, and which of its fields can be fitted."""

from __future__ import annotations

import collections
import dataclasses
import json
import math
from typing import TYPE_CHECKING, Any

from .files import existing
from .options import ScenePath
from .status import SUCCESS

if TYPE_CHECKING:
    import numpy as np

    from jaxlight.scene import Scene


@dataclasses.dataclass(frozen=True)
class Info:
    """Say what a scene holds: nodes, lights, cameras, and every field that can be fitted, with its path.

    $ jaxlight info scene.x3d
    $ jaxlight info mesh.glb
    $ jaxlight info scene.x3d --json | python3 -m json.tool

    The paths in the last table are what `jaxlight fit --free` takes."""

    scene: ScenePath
    """An X3D file, or a mesh (glb, obj, ply, stl)."""
    json: bool = False
    """One JSON object instead of text."""

    def run(self) -> int:
        """Print the description."""
        existing(self.scene)
        from jaxlight import load

        description = describe(load(self.scene))
        print(json.dumps(description, indent=2) if self.json else _as_text(str(self.scene), description))
        return SUCCESS


def describe(scene: Scene) -> dict[str, Any]:
    """What the scene holds, as data that JSON can carry."""
    from jaxlight.formats.x3d_writer import all_nodes

    document = scene.document
    kinds = collections.Counter(type(node).__name__ for node in all_nodes(document.children))
    return {
        "nodes": dict(sorted(kinds.items())),
        "shapes": _shapes(scene),
        "viewpoints": [
            {
                "name": placed.node.name,
                "position": list(placed.node.position),
                "orientation": list(placed.node.orientation),
                "field_of_view": placed.node.field_of_view,
            }
            for placed in document.viewpoints
        ],
        "lights": _lights(scene),
        "headlight": scene.directional is not None and scene.directional.headlight,
        "fog": None if document.fog is None else document.fog.label,
        "textures": [
            {"name": node.label, "size": [node.image.shape[1], node.image.shape[0]], "components": node.image.shape[2]}
            for node in document.textures
            if node.image is not None
        ],
        "fields": _fields(scene),
    }


def _shapes(scene: Scene) -> list[dict[str, Any]]:
    shapes = []
    for placed in scene.document.shapes:
        surface = scene.surfaces[placed.surface]
        material = scene.document.materials[surface.material].label if surface.material >= 0 else None
        geometry = None if placed.node.geometry is None else type(placed.node.geometry).__name__
        shapes.append({"name": placed.node.label, "geometry": geometry, "material": material})
    return shapes


def _lights(scene: Scene) -> list[dict[str, Any]]:
    lights = []
    for rows, placed in (
        (scene.document.directional, scene.directional),
        (scene.document.point, scene.point),
        (scene.document.spot, scene.spot),
    ):
        for row, node in enumerate(rows):
            assert placed is not None  # a light in the document has its row in the scene
            reaches = sum(bool(placed.in_scope.array[shape.surface, row]) for shape in scene.document.shapes)
            lights.append({"name": node.label, "on": node.on, "in_scope_of_shapes": reaches})
    return lights


def _fields(scene: Scene) -> list[dict[str, Any]]:
    from jaxlight.scene.paths import fields

    headlight = scene.directional is not None and scene.directional.headlight  # in no file: it cannot be fitted
    return [
        {
            "path": field.path,
            "value": _value(field.value(scene)),
            "range": str(field.leaf.range),
            "has_slope": field.leaf.field != "radius",
        }
        for field in fields(scene)
        if not (headlight and field.leaf.kind == "DirectionalLight")
    ]


def _value(value: np.ndarray) -> Any:
    """Numbers as JSON has them (an infinite radius as text); a texture by its size."""
    if value.ndim > 1:
        return f"{value.shape[1]} x {value.shape[0]}, {value.shape[2]} components"
    numbers = [float(f"{x:.7g}") if math.isfinite(x) else str(x) for x in value.reshape(-1).tolist()]
    return numbers if value.ndim else numbers[0]


def _as_text(title: str, description: dict[str, Any]) -> str:
    """The description for a person."""
    lines = [title]

    def row(head: str, items: list[str]) -> None:
        for i, item in enumerate(items or ["none"]):
            lines.append(f"  {head if i == 0 else '':<10} {item}")

    row("nodes", [", ".join(f"{count} {kind}" for kind, count in description["nodes"].items())])
    shapes = collections.Counter(
        f"{shape['geometry'] or 'no geometry'}, {shape['material'] or 'unlit'}" for shape in description["shapes"]
    )
    row("shapes", [f"{count} x {what}" for what, count in shapes.items()])
    none = "none: X3D's default view if it shows all shapes at a fair size, otherwise one that frames them"
    row("cameras", [_camera(view) for view in description["viewpoints"]] or [none])
    total = len(description["shapes"])
    lights = [
        f"{light['name']}, {'on' if light['on'] else 'off'}, {light['in_scope_of_shapes']} of {total} shapes in scope"
        for light in description["lights"]
    ]
    row("lights", lights)
    if description["headlight"]:
        row("", ["the headlight stands in no file and cannot be fitted; add a light to the scene for that"])
    row("fog", [description["fog"]] if description["fog"] else [])
    row(
        "textures",
        [f"{t['name']}, {t['size'][0]} x {t['size'][1]}, {t['components']}" for t in description["textures"]],
    )

    lines += ["", "Fields that can be fitted (jaxlight fit --free PATH)"]
    table = [(field["path"], _shown(field["value"]), _allowed(field)) for field in description["fields"]]
    widths = [max((len(cells[column]) for cells in table), default=0) for column in (0, 1)]
    lines += [f"  {path:<{widths[0]}}  {value:<{widths[1]}}  {allowed}" for path, value, allowed in table]
    return "\n".join(lines)


def _allowed(field: dict[str, Any]) -> str:
    return field["range"] + ("" if field["has_slope"] else " (no slope: a fit does not move it)")


def _camera(view: dict[str, Any]) -> str:
    name = f"Viewpoint[{view['name']}]" if view["name"] else "Viewpoint"
    return f"{name}, position {_shown(view['position'])}, field of view {view['field_of_view']:.4g} rad"


def _shown(value: Any) -> str:
    if isinstance(value, list):
        return " ".join(_shown(number) for number in value)
    return f"{value:.6g}" if isinstance(value, float) else str(value)
