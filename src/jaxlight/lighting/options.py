"""How the specification is read where its texts disagree or leave a choice, and how accurately."""

from __future__ import annotations

import dataclasses
from typing import Literal

from ..given import plain


@dataclasses.dataclass(frozen=True)
class LightingOptions:
    """Readings of the lighting equation; hashable, static under jit. The defaults are the specification's tables.

    Raises:
        ValueError: a value that is not among those allowed.
    """

    texture_mode: Literal["replace", "modulate"] = "replace"
    """RGB textures replace the diffuse colour (tables 4.6, 17.3), or modulate it (prose of 17.2.2.3)."""
    fog_unlit: bool = True
    """Whether fog also covers unlit shapes."""
    specular_gate: bool = False
    """True: no highlight where N . L <= 0 (the habit of OpenGL); False: the equation as it is written."""
    support_level: Literal[1, 2, 3] = 3
    """Table 17.6. 1: directional lights only, not scoped. 2: attenuation linear, directional lights not scoped."""
    accuracy: Literal["full", "fast"] = "full"
    """full: every digit that the inputs have. fast: highlights to 1e-4 of themselves (docs/precision.md)."""

    def __post_init__(self) -> None:
        allowed = {
            "texture_mode": ("replace", "modulate"),
            "fog_unlit": (True, False),
            "specular_gate": (True, False),
            "support_level": (1, 2, 3),
            "accuracy": ("full", "fast"),
        }
        for name, values in allowed.items():
            own = plain(getattr(self, name))
            if type(own) is not type(values[0]) or own not in values:
                expected = " or ".join(map(repr, values))
                raise ValueError(f"LightingOptions.{name}: expected {expected}, got {own!r:.60}")
            object.__setattr__(self, name, own)
