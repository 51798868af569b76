"""`jaxlight gradcheck`: are the derivatives of a scene right?"""

from __future__ import annotations

import dataclasses
from typing import Annotated

import tyro

from .cameras import camera_of
from .files import existing
from .options import Precision, Reading, ScenePath, SharedReading, use_precision
from .progress import stages
from .status import FAILURE, SUCCESS


@dataclasses.dataclass(frozen=True)
class Gradcheck:
    """Compare the derivatives of every field, forward and reverse, with central differences.

    $ jaxlight gradcheck scene.x3d
    $ jaxlight gradcheck scene.x3d --fields 'Material[*].shininess' 'SpotLight[rim].*'
    $ jaxlight gradcheck scene.x3d --precision float32

    A row a field: the largest derivative, and the error of both modes relative to it. Exit status 1 if one is wrong."""

    scene: ScenePath
    """An X3D file, or a mesh (glb, obj, ply, stl)."""
    fields: Annotated[tuple[str, ...], tyro.conf.arg(metavar="PATH ...")] = ()
    """Field paths (default: every field that `jaxlight info` lists)."""
    width: int = 64
    """Pixels."""
    height: int | None = None
    """Pixels (default: as the width)."""
    viewpoint: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    """DEF name or number of a Viewpoint (default: the first; without any, X3D's own if it shows all shapes at a fair
    size, otherwise a camera that frames them)."""
    tolerance: float | None = None
    """Error that passes (default: 1e-6 in float64, 1e-3 in float32)."""
    precision: Precision = "float64"
    """Type of the derivatives; the central differences are always float64."""
    reading: SharedReading = dataclasses.field(default_factory=Reading)

    def run(self) -> int:
        """Print the table."""
        existing(self.scene)
        use_precision(self.precision)
        with stages(3) as stage:
            stage(f"reading {self.scene}")
            from jaxlight import check_gradients, load, rasterize

            scene = load(self.scene)
            stage("finding what is visible")
            samples = rasterize(scene, camera_of(scene, self.viewpoint), self.width, self.height)
            stage("comparing derivatives")
            check = check_gradients(
                scene,
                samples,
                list(self.fields) or None,
                tolerance=self.tolerance,
                options=self.reading.lighting_options(),
            )
        print(check)
        return SUCCESS if check.passed else FAILURE
