"""From the views of a problem to what `fit` takes: pictures read, what is visible found."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .cameras import camera_of
from .problem import CameraProblem, FitProblem, MapsProblem, Source, ViewProblem, blamed_on

if TYPE_CHECKING:
    import numpy as np

    import jaxlight

_WHOLE = 0.999
"""Alpha from here on is 1, for filters round."""


def make_views(problem: FitProblem, source: Source, scene: jaxlight.Scene) -> list[jaxlight.View]:
    """The views, in their order; equal cameras and sizes share their samples.

    Raises:
        ValueError: a picture, map or camera that does not fit; says which, by `source`.
    """
    views = []
    known: dict[Any, Any] = {}
    stems = [view.picture.stem for view in problem.views]
    given = [view.name for view in problem.views]
    for row, view in enumerate(problem.views):
        stem = view.picture.stem
        name = view.name or (stem if stems.count(stem) == 1 and stem not in given else f"{stem}_{row}")
        views.append(_make_view(view, name, row, source, scene, known))
    return views


def _make_view(
    view: ViewProblem, name: str, row: int, source: Source, scene: jaxlight.Scene, known: dict[Any, Any]
) -> jaxlight.View:
    from jaxlight import View, decode, read_image
    from jaxlight.formats.images import holds_levels, is_exr

    with blamed_on(source, "views", row, "picture"):
        target, opaque = _colors_and_opaque(view.picture)
    height, width = target.shape[:2]
    if view.saturated is not None and 1 < view.saturated < math.inf and holds_levels(view.picture):
        allowed = f"a number <= 1, where the numbers of {view.picture.name} end, or inf for none"
        raise source.error(("views", row, "saturated"), f"expected {allowed}, got {view.saturated:g}")

    def beside(field: str, *, grey: bool) -> Any:
        """A picture of the same size: [height, width], or with its components."""
        path = getattr(view, field)
        if not isinstance(path, Path):
            return path
        with blamed_on(source, "views", row, field):
            image = read_image(path)
            if image.shape[:2] != (height, width):
                size = f"{image.shape[1]} x {image.shape[0]}"
                raise ValueError(f"{path}: expected {width} x {height} pixels as in {view.picture}, got {size}")
        if image.shape[2] in (2, 4):
            image = image[..., :-1]
        return image.mean(axis=-1) if grey or image.shape[2] == 1 else image

    background = beside("background", grey=False)
    if isinstance(view.background, Path):
        background = decode(background, view.decode)
    where = (view.viewpoint, view.camera, view.maps, view.samples, width, height)
    if where not in known:
        try:
            known[where] = _samples(view, scene, width, height)
        except ValueError as error:
            key, message = _geometry_mistake(view, str(error))
            raise source.error(("views", row, *key), message) from None
    mask = beside("mask", grey=True)
    if mask is not None:
        with blamed_on(source, "views", row, "mask"):
            mask = _chosen(mask, f"{view.mask}", known[where])
    if opaque is not None:
        mask = opaque if mask is None else mask & opaque
    # Integer formats end at 1; what lies there may have been brighter.
    ends_at_one = not (is_exr(view.picture) or (target > 1).any())
    return View(
        known[where],
        decode(target, view.decode),
        mask=mask,
        weight=beside("weight", grey=False),
        noise=beside("noise", grey=False),
        exposure=view.exposure,
        lights=view.lights,
        saturated=1.0 if view.saturated is None and ends_at_one else view.saturated,
        dark=view.dark,
        background=background,
        name=name,
    )


def _colors_and_opaque(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    """The colours of a picture, and which of its pixels show something; None: all."""
    from jaxlight import read_image
    from jaxlight.formats.images import is_exr

    image = read_image(path)
    if image.shape[2] not in (1, 3):
        # The colours of an EXR are multiplied by alpha: where that is no 1 they are no colours that were seen.
        return image[..., :-1], image[..., -1] > (_WHOLE if is_exr(path) else 0)
    return image, None


def _chosen(mask: np.ndarray, name: str, samples: jaxlight.SampleBuffer) -> np.ndarray:
    """What a mask chooses, if that is something that is seen."""
    import numpy as np

    from jaxlight.formats.levels import is_chosen

    chosen = is_chosen(mask, name)
    seen = chosen.ravel()[np.asarray(samples.pixel)]
    if seen.size and not seen.any():
        brightest = f"its brightest number is {mask.max():.3g}"
        reason = "it is dark wherever something is seen" if chosen.any() else brightest
        raise ValueError(f"{name}: leaves nothing to fit: {reason}, and what is below 0.5 is not fitted")
    return chosen


def _geometry_mistake(view: ViewProblem, message: str) -> tuple[tuple[str, ...], str]:
    """The entry that says what is seen from where, or the one in it that a message begins with; and what it says."""
    name, _, said = message.partition(": ")
    if name == "samples":
        return (name,), said
    given = [name for name in ("maps", "camera", "viewpoint") if getattr(view, name) is not None]
    field, _, told = said.partition(": ")
    if given[:1] == ["camera"] and field in (one.name for one in dataclasses.fields(CameraProblem)):
        return ("camera", field), told
    return tuple(given[:1]), message


def _samples(view: ViewProblem, scene: jaxlight.Scene, width: int, height: int) -> jaxlight.SampleBuffer:
    from jaxlight import Camera, Orthographic, rasterize, samples_from_maps

    if view.camera is not None and view.viewpoint is not None:
        raise ValueError("expected a camera or a viewpoint, not both")
    if view.camera is not None:
        camera = Camera.from_intrinsics(**dataclasses.asdict(view.camera))
    elif view.maps is not None and view.viewpoint is None:
        camera = Orthographic(view.maps.pixel_size)
    else:
        camera = camera_of(scene, view.viewpoint or "")
    if view.maps is None:
        assert isinstance(camera, Camera)
        return rasterize(scene, camera, width, height, samples=view.samples)
    if view.samples != 1:
        raise ValueError("maps give one sample a pixel; leave out samples")
    options = {
        field.name: getattr(view.maps, field.name)
        for field in dataclasses.fields(MapsProblem)
        if field.name not in ("normal", "pixel_size")
    }
    samples = samples_from_maps(view.maps.normal, camera, **options)
    if (samples.height, samples.width) != (height, width):
        size = f"{samples.width} x {samples.height}"
        raise ValueError(f"{view.maps.normal}: expected {width} x {height} pixels as in {view.picture}, got {size}")
    return samples
