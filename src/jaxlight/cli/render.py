"""`jaxlight render`: a scene to a picture."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Literal

import tyro

from .cameras import camera_of
from .files import existing, files_of_scene, picture_path, spare
from .options import Precision, Reading, ScenePath, SharedReading, use_precision
from .progress import stages
from .status import SUCCESS


@dataclasses.dataclass(frozen=True)
class Render:
    """Render a scene to a picture.

    $ jaxlight render scene.x3d --output scene.png
    $ jaxlight render scene.x3d --output big.png --width 1920 --height 1080 --samples 16
    $ jaxlight render scene.x3d --output srgb.png --encode srgb --viewpoint top

    The picture holds the equation's numbers as they are, as X3D browsers show them; in .png and .jpg up to 1."""

    scene: ScenePath
    """An X3D file, or a mesh (glb, obj, ply, stl)."""
    output: Annotated[Path, tyro.conf.arg(aliases=("-o",))]
    """The picture to write (.png, .jpg or .exr)."""
    width: int = 512
    """Pixels."""
    height: int | None = None
    """Pixels (default: as the width)."""
    samples: int = 1
    """Samples a pixel; 16 gives smooth edges."""
    viewpoint: Annotated[str, tyro.conf.arg(metavar="NAME")] = ""
    """DEF name of a Viewpoint or its number from 0 (default: the first; without any, X3D's own if it shows all shapes
    at a fair size, otherwise a camera that frames them)."""
    encode: Literal["none", "srgb"] = "none"
    """Write the numbers as they are, or as sRGB of linear light."""
    precision: Precision = "float32"
    """Type of the numbers."""
    reading: SharedReading = dataclasses.field(default_factory=Reading)

    def run(self) -> int:
        """Write the picture."""
        existing(self.scene)
        spare([self.scene], [self.output])
        picture_path(self.output)
        with stages(4) as stage:
            use_precision(self.precision)
            stage(f"reading {self.scene}")
            from jaxlight import encode, load, rasterize, render, write_image

            scene = load(self.scene)
            spare(files_of_scene(self.scene, scene), [self.output])
            camera = camera_of(scene, self.viewpoint)
            stage("finding what is visible")
            samples = rasterize(scene, camera, self.width, self.height, samples=self.samples)
            stage("shading")
            picture = render(scene, samples, self.reading.lighting_options())
            stage(f"writing {self.output}")
            self.output.parent.mkdir(parents=True, exist_ok=True)
            write_image(self.output, encode(picture, self.encode))
        return SUCCESS
