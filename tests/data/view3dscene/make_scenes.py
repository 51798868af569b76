"""Write texture_mapping.x3d, normals.x3d and ramp.png, the scenes whose pictures view3dscene made.

Texture mapping: unlit shapes under a texture that holds s in red and t in green. Normals: white diffuse shapes under
three lights along the axes, red, green and blue, so that the picture holds max(0, n).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL import Image

HERE = Path(__file__).parent
HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<X3D profile="Interchange" version="3.2">
  <Scene>
    <NavigationInfo headlight="false"/>
    <Background skyColor="0.2 0.2 0.2"/>
    <Viewpoint position="0 0 20" fieldOfView="0.7"/>
"""
TAIL = "  </Scene>\n</X3D>\n"
PYRAMID = """<IndexedFaceSet solid="false" coordIndex="0 1 2 -1 0 2 3 -1 0 3 1 -1">
        <Coordinate point="0 1 0 -1.2 -1 1 0.9 -1 1 0 -1 -1"/></IndexedFaceSet>"""
HOOK = """<IndexedFaceSet solid="false" convex="false" coordIndex="0 1 2 3 4 5 -1">
        <Coordinate point="-1 -1 0 1 -1 0 1 0 0 0 0 0 0 1 0 -1 1 0"/></IndexedFaceSet>"""
GEOMETRIES = ("<Box/>", "<Cone/>", "<Cylinder/>", "<Sphere/>", PYRAMID, HOOK)
ATTITUDES = ("1 0 0 0.6", "1 0 0 -0.7", "0 1 0 2.5", "1 1 0 2.9")
TRANSFORM = '<TextureTransform center="0.3 0.2" rotation="0.5" scale="0.7 0.6" translation="0.1 -0.2"/>'
BOX = """coordIndex="0 3 2 1 -1 4 5 6 7 -1 0 1 5 4 -1 1 2 6 5 -1 2 3 7 6 -1 3 0 4 7 -1">
        <Coordinate point="-1 -1 -1 1 -1 -1 1 1 -1 -1 1 -1 -1 -1 1 1 -1 1 1 1 1 -1 1 1"/></IndexedFaceSet>"""
PROFILE = ((0.3, -1.2), (1.0, -0.6), (0.9, 0.1), (0.4, 0.5), (0.5, 1.2))
CREASE_ANGLES = (0, 0.6, 0.9, 1.2, 3.2)


def ramp(size: int = 64) -> np.ndarray:
    """Texture whose texel centres hold their own s (red) and t (green)."""
    at = (np.arange(size) + 0.5) / size
    s, t = np.meshgrid(at, at[::-1])
    return np.round(255 * np.stack([s, t, np.zeros_like(s)], axis=-1)).astype(np.uint8)


def texture_mapping() -> Iterator[str]:
    """Every geometry in four attitudes, the last row with a TextureTransform."""
    for row, attitude in enumerate(ATTITUDES):
        for column, geometry in enumerate(GEOMETRIES):
            yield (
                f'    <Transform translation="{3 * column - 7.5} {4.5 - 3 * row} 0" rotation="{attitude}"><Shape>\n'
                f'      <Appearance><ImageTexture url="ramp.png" repeatS="false" repeatT="false"/>'
                f"{TRANSFORM if row == 3 else ''}</Appearance>\n      {geometry}\n    </Shape></Transform>\n"
            )


def vase(sides: int = 12) -> str:
    """A surface of revolution from a polyline, all quadrilaterals."""
    points, faces, rings = [], [], len(PROFILE)
    for side in range(sides):
        angle = 2 * math.pi * side / sides
        points += [f"{r * math.sin(angle):.6g} {y} {r * math.cos(angle):.6g}" for r, y in PROFILE]
        for ring in range(rings - 1):
            here, there = side * rings + ring, (side + 1) % sides * rings + ring
            faces.append(f"{here} {there} {there + 1} {here + 1} -1")
    return f'coordIndex="{" ".join(faces)}">\n        <Coordinate point="{" ".join(points)}"/></IndexedFaceSet>'


def normals() -> Iterator[str]:
    """A box and a vase with five crease angles, solid and not."""
    for direction, color in (("-1 0 0", "1 0 0"), ("0 -1 0", "0 1 0"), ("0 0 -1", "0 0 1")):
        yield f'    <DirectionalLight direction="{direction}" color="{color}"/>\n'
    for column, crease in enumerate(CREASE_ANGLES):
        for row, (mesh, solid) in enumerate((mesh, solid) for mesh in (BOX, vase()) for solid in ("false", "true")):
            yield (
                f'    <Transform translation="{3 * column - 6} {4.5 - 3 * row} 0" rotation="1 1 0 0.6"><Shape>\n'
                f'      <Appearance><Material diffuseColor="1 1 1" ambientIntensity="0"/></Appearance>\n'
                f'      <IndexedFaceSet solid="{solid}" creaseAngle="{crease}" {mesh}\n    </Shape></Transform>\n'
            )


def main() -> None:
    """Write the files beside this one."""
    Image.fromarray(ramp()).save(HERE / "ramp.png")
    (HERE / "texture_mapping.x3d").write_text(HEAD + "".join(texture_mapping()) + TAIL)
    (HERE / "normals.x3d").write_text(HEAD + "".join(normals()) + TAIL)


if __name__ == "__main__":
    main()
