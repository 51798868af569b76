"""`jaxlight fit`."""

from __future__ import annotations
import dataclasses
from .options import ScenePath


@dataclasses.dataclass(frozen=True)
class Fit:
    """Fit materials and lights of a scene to one or many pictures."""

    scene: ScenePath

    def run(self) -> int:
        return 0
