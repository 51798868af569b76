"""Oracle cases as jaxlight scenes: one case, or many of one structure stacked along a leading axis for vmap."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxlight.lighting import LightingOptions
from jaxlight.raster import SampleBuffer
from jaxlight.scene import DirectionalLights, Fog, Materials, PointLights, Scene, SpotLights, Surface, Texture
from jaxlight.scene.flags import Flags
from oracle.case import Case, Light

KINDS = {"directional": DirectionalLights, "point": PointLights, "spot": SpotLights}
FIELDS = {
    "directional": ("ambient_intensity", "color", "direction", "intensity"),
    "point": ("ambient_intensity", "attenuation", "color", "intensity", "location", "radius"),
    "spot": (
        "ambient_intensity",
        "attenuation",
        "beam_width",
        "color",
        "cut_off_angle",
        "direction",
        "intensity",
        "location",
        "radius",
    ),
}
MATERIAL = ("ambient_intensity", "diffuse_color", "emissive_color", "shininess", "specular_color", "transparency")


def structure(case: Case) -> tuple:
    """What cases must share to be stacked: everything static in their scene."""
    return (
        case.line_or_point,
        case.material is None,
        tuple((light.kind, light.on, light.in_scope, light.frame is None) for light in case.lights),
        None if case.fog is None else (case.fog.fog_type, case.fog.frame is None),
        case.options,
        0 if case.sample.color is None else len(case.sample.color),
        0 if case.sample.texel is None else len(case.sample.texel),
    )


def scene_and_sample(case: Case, dtype: Any) -> tuple[Scene, SampleBuffer]:
    """One case as a scene and a buffer of one sample."""
    stacked = scenes_and_samples([case], dtype)
    return take(stacked, 0)


def take(stacked: Any, index: int) -> Any:
    """One case of a stack."""
    return jax.tree.map(lambda leaf: leaf[index], stacked)


def scenes_and_samples(cases: Sequence[Case], dtype: Any) -> tuple[Scene, SampleBuffer]:
    """Cases of one structure, every leaf with a leading axis [cases]; samples come in tiles of one."""
    first = cases[0]
    assert all(structure(case) == structure(first) for case in cases)

    def stack(values: list) -> Any:
        return jnp.asarray(np.asarray(values, dtype=np.float64).astype(dtype))

    lights = {}
    for kind, maker in KINDS.items():
        rows = [[light for light in case.lights if light.kind == kind] for case in cases]
        lights[kind] = _lights(maker, FIELDS[kind], rows, stack) if rows[0] else None
    materials = None
    if first.material is not None:
        fields = {name: stack([[getattr(case.material, name)] for case in cases]) for name in MATERIAL}
        materials = Materials(**fields, names=("",))
    texel, color = first.sample.texel, first.sample.color
    lighting = "lit" if materials is not None else "unlit"
    if first.line_or_point and materials is not None:
        lighting = "emissive"
    surface = Surface(lighting, 0 if materials is not None else -1, 0 if texel else -1, len(color) if color else 0)
    scene = Scene(
        materials=materials,
        directional=lights["directional"],
        point=lights["point"],
        spot=lights["spot"],
        fog=None if first.fog is None else _fog(cases, stack),
        textures=(Texture(stack([[[case.sample.texel]] for case in cases])),) if texel else (),
        surfaces=(surface,),
        document=None,
    )
    return scene, _samples(cases, stack)


def options_of(case: Case) -> LightingOptions:
    """The case's options as jaxlight's."""
    chosen = case.options
    return LightingOptions(chosen.texture_mode, chosen.fog_unlit, chosen.specular_gate, chosen.support_level)


def _frame(frame: Any) -> np.ndarray:
    return np.eye(3, 4) if frame is None else np.asarray(frame, dtype=np.float64)


def _lights(maker: Any, names: tuple[str, ...], rows: list[list[Light]], stack: Any) -> Any:
    fields = {name: stack([[getattr(light, name) for light in row] for row in rows]) for name in names}
    frames = np.array([[_frame(light.frame) for light in row] for row in rows])
    fields["to_world"] = stack(frames)
    if "location" in names:
        fields["to_local"] = stack(np.linalg.inv(frames[..., :3]))
    flags = {"on": Flags([light.on for light in rows[0]]), "in_scope": Flags([[light.in_scope for light in rows[0]]])}
    frame = "identity" if all(light.frame is None for light in rows[0]) else "general"
    return maker(**fields, **flags, names=("",) * len(rows[0]), frame=frame)


def _fog(cases: Sequence[Case], stack: Any) -> Fog:
    fogs = [case.fog for case in cases]
    return Fog(
        color=stack([fog.color for fog in fogs]),
        visibility_range=stack([fog.visibility_range for fog in fogs]),
        to_local=stack([np.linalg.inv(_frame(fog.frame)[:, :3]) for fog in fogs]),
        fog_type=fogs[0].fog_type,
        frame="identity" if fogs[0].frame is None else "general",
    )


def _samples(cases: Sequence[Case], stack: Any) -> SampleBuffer:
    """Buffers of one sample, stacked: a template with its leaves replaced."""
    samples = [case.sample for case in cases]
    first = samples[0]
    count = len(cases)
    template = SampleBuffer.create(np.zeros((1, 3)), np.ones((1, 3)), np.zeros(3), tile=1)
    position = stack([[[[x] for x in sample.position]] for sample in samples])
    integers = jnp.zeros((count, 4, 1), dtype=jnp.int32)
    changes = {
        "position_planes": position,
        "normal_planes": stack([[[[x] for x in sample.normal]] for sample in samples]),
        "eye": stack([sample.eye for sample in samples]),
        "color_planes": None if first.color is None else stack([[[[x] for x in sample.color]] for sample in samples]),
        "texel_index": None if first.texel is None else integers,
        "texel_weight": None if first.texel is None else stack([[[1.0], [0.0], [0.0], [0.0]]] * count),
        "tile_surface": jnp.zeros((count, 1), dtype=jnp.int32),
        "tile_low": position[:, 0],
        "tile_high": position[:, 0],
        "cluster_low": position[:, 0],
        "cluster_high": position[:, 0],
    }
    return dataclasses.replace(template, **changes)
