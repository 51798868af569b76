"""Write spot.x3d, the scene that the independent renderer was given, from spot_triangulated.obj.

In: spot_triangulated.obj (Keenan Crane, public domain). Out: spot.x3d beside it, in the X3D XML encoding. The
pictures spot_256.png and spot_512.png are made from that file by `view3dscene`, as HOW_IT_WAS_MADE.txt says.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
EYE = np.array([-2.3, 1.0, -2.9])
LOOK_AT = np.array([0.0, 0.08, 0.05])

SCENE = """<?xml version="1.0" encoding="UTF-8"?>
<X3D profile="Interchange" version="3.2">
  <head><meta name="reference" content="Spot by Keenan Crane, public domain"/></head>
  <Scene>
    <NavigationInfo headlight="false"/>
    <Background skyColor="0 0 0"/>
    <Viewpoint DEF="camera" position="{eye}" orientation="{orientation}" fieldOfView="0.5"/>
    <PointLight DEF="key" location="-2.6 2.4 -1.4" color="1 1 1" intensity="1" ambientIntensity="0"
        attenuation="0.2 0 0.1" radius="100"/>
    <Shape>
      <Appearance>
        <Material DEF="body" diffuseColor="0.75 0.5 0.3" specularColor="0.3 0.35 0.4" shininess="0.25"
            ambientIntensity="0"/>
      </Appearance>
      <IndexedFaceSet creaseAngle="3.15" coordIndex="
{faces}">
        <Coordinate point="
{points}"/>
        <Normal vector="
{normals}"/>
      </IndexedFaceSet>
    </Shape>
  </Scene>
</X3D>
"""


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertex positions [n, 3] and triangles [m, 3] (from 0) of a Wavefront OBJ file, in the file's order."""
    lines = [line.split() for line in path.read_text().splitlines()]
    points = np.array([words[1:4] for words in lines if words[:1] == ["v"]], float)
    faces = [[int(corner.split("/")[0]) - 1 for corner in words[1:]] for words in lines if words[:1] == ["f"]]
    return points, np.array(faces)


def vertex_normals(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals [n, 3]: the mean of the adjoining triangles' normals, weighted by their areas."""
    corners = points[faces]
    face = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros_like(points)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], face)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def orientation(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Axis and angle that turn the X3D camera (looking down -z, y up) at `eye` towards `target`, upright."""
    z = (eye - target) / np.linalg.norm(eye - target)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    turn = np.stack([x, np.cross(z, x), z], axis=1)
    angle = np.arccos((np.trace(turn) - 1) / 2)
    axis = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / (2 * np.sin(angle))
    return np.append(axis, angle)


def rows(values: np.ndarray, pattern: str) -> str:
    """One row of numbers a line."""
    return "\n".join(" ".join(pattern % number for number in row) for row in values)


def main() -> None:
    """Write spot.x3d beside this file."""
    points, faces = read_obj(HERE / "spot_triangulated.obj")
    text = SCENE.format(
        eye=" ".join(f"{number:g}" for number in EYE),
        orientation=" ".join(f"{number:.9f}" for number in orientation(EYE, LOOK_AT)),
        faces=rows(np.insert(faces, 3, -1, axis=1), "%d"),
        points=rows(points, "%.6g"),
        normals=rows(vertex_normals(points, faces), "%.5f"),
    )
    (HERE / "spot.x3d").write_text(text)


if __name__ == "__main__":
    main()
