"""Options that several commands share, and what they mean to the library."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from jaxlight.lighting import LightingOptions

Precision = Literal["float32", "float64"]

ScenePath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SCENE")]


@dataclasses.dataclass(frozen=True)
class Reading:
    """How the specification is read where its texts disagree (docs/readings.md), and how accurately it is computed."""

    texture_mode: Literal["replace", "modulate"] = "replace"
    """RGB textures replace the diffuse colour (tables 4.6 and 17.3) or modulate it (17.2.2.3)."""
    fog_unlit: bool = True
    """Fog covers unlit shapes too."""
    specular_gate: bool = False
    """No highlight where the light is behind the surface (N.L <= 0), as OpenGL does."""
    support_level: Literal[1, 2, 3] = 3
    """Lighting support level of table 17.6."""
    accuracy: Literal["full", "fast"] = "full"
    """fast: highlights to 1e-4 of themselves (docs/precision.md)."""

    def lighting_options(self) -> LightingOptions:
        """The library's form of these options."""
        from jaxlight.lighting import LightingOptions

        return LightingOptions(**dataclasses.asdict(self))


SharedReading = Annotated[Reading, tyro.conf.arg(name="")]


def use_precision(precision: Precision) -> None:
    """Compute in this float type. The library never touches JAX's configuration; a program may."""
    import jax

    jax.config.update("jax_enable_x64", precision == "float64")
