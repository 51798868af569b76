"""jaxlight by its public functions: nodes to Scene, rows to SampleBuffer, shading, JAX's transformations."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxlight.lighting import (
    LightingOptions,
    Plan,
    compiler_options,
    make_plan,
    shade_slots,
    shade_tiles,
    sum_over_samples,
)
from jaxlight.raster import SampleBuffer
from jaxlight.scene import Scene, nodes

from ..workload import Arrays, Workload
from .base import Contender, Operation, Run, ValueAndGradient

_LIGHT_NODES = {"directional": nodes.DirectionalLight, "point": nodes.PointLight, "spot": nodes.SpotLight}


def scene_of(work: Workload, arrays: Arrays, dtype: Any, materials: int = 1) -> Scene:
    """The workload as X3D nodes, flattened; with several materials, all of them alike, a shape each."""
    color = None if arrays.sample_color is None else nodes.Color(color=np.ones((1, 3)))
    shapes = []
    for _ in range(materials):
        material = nodes.Material(**{name: value.tolist() for name, value in arrays.material.items()})
        shapes.append(
            nodes.Shape(appearance=nodes.Appearance(material=material), geometry=nodes.IndexedFaceSet(color=color))
        )
    light_node = _LIGHT_NODES[work.kind]
    lights = [
        light_node(
            **{name: rows[i].tolist() for name, rows in arrays.lights.items()}, global_=True, on=bool(arrays.on[i])
        )
        for i in range(work.lights)
    ]
    fog = (
        nodes.Fog(color=arrays.fog_color.tolist(), visibility_range=arrays.fog_visibility, fog_type=work.fog)
        if work.fog != "NONE"
        else None
    )
    return Scene.from_nodes([*shapes, *lights, *([fog] if fog else [])], dtype=dtype)


def samples_of(
    arrays: Arrays, dtype: Any, tile: int | None = None, materials: int = 1, by_place: bool = False
) -> SampleBuffer:
    """The workload's samples; with several materials, each on a band of them."""
    count = arrays.position.shape[1]
    surface = np.arange(count) * materials // count
    color = None if arrays.sample_color is None else arrays.sample_color.T
    return SampleBuffer.create(
        position=arrays.position.T,
        normal=arrays.normal.T,
        eye=arrays.eye,
        color=color,
        surface=surface,
        dtype=dtype,
        tile=tile,
        by_place=by_place,
    )


def free_fields(scene: Scene, kind: str) -> dict[str, Any]:
    """The fields of the common gradient, by the names of `Arrays.parameters`, out of a Scene (or a gradient of one)."""
    groups = {"material": scene.materials, "lights": getattr(scene, kind)}
    return {f"{group}.{name}": value for group, node in groups.items() for name, value in vars(node).items()}


def split_fields(scene: Scene, kind: str, names: Sequence[str]) -> tuple[Scene, Scene]:
    """The fields of these names, by which all contenders differentiate, and the rest of the scene; None elsewhere."""
    chosen = jax.tree.map(lambda _: False, scene)
    chosen = eqx.tree_at(lambda own: [free_fields(own, kind)[name] for name in names], chosen, [True] * len(names))
    return eqx.partition(scene, chosen)


class JaxlightShade(Contender):
    """The library as it is called.

    Args:
        work, arrays: the workload.
        precision: float type of scene and samples.
        skip: False plans as if every field were free, so that nothing is skipped.
        tile: samples a tile; None: the library's choice.
        materials: how many Material nodes, alike, share the samples.
        lighting: fields of LightingOptions, as pairs.
        by_samples: gradients are by positions, normals and colours of all samples, too.
        by_place: how samples are stored; None: as `rasterize` stores them.
        by_tiles: the loss is a `sum_over_samples`.
    """

    def __init__(
        self,
        work: Workload,
        arrays: Arrays,
        precision: str = "float32",
        skip: bool = True,
        tile: int | None = None,
        materials: int = 1,
        lighting: Any = (),
        by_samples: bool = False,
        by_place: bool | None = None,
        by_tiles: bool = False,
    ) -> None:
        dtype = jnp.dtype(precision)
        # Half-precision samples are shaded with single-precision fields.
        self._scene = scene_of(work, arrays, jnp.promote_types(dtype, jnp.float32), materials)
        by_place = work.cover > 0 if by_place is None else by_place
        self._samples = samples_of(arrays, dtype, tile, materials, by_place)
        self._options = LightingOptions(**dict(lighting))
        self._skip, self._by_samples, self._by_tiles = skip, by_samples, by_tiles
        self._kind = work.kind
        self._names = list(arrays.parameters)
        # Targets in storage order; padding weighs nothing.
        slots = self._samples.slots
        slot = np.arange(work.samples) if self._samples.slot is None else np.asarray(self._samples.slot)
        target, weight = np.zeros((3, slots), np.float32), np.zeros(slots, np.float32)
        target[:, slot], weight[slot] = arrays.target, 1
        in_tiles = np.ascontiguousarray(target.reshape(3, -1, self._samples.tile).swapaxes(0, 1))
        self._target = jnp.asarray(in_tiles, self._scene.materials.diffuse_color.dtype)
        weight = weight.reshape(-1, 1, self._samples.tile)
        self._weight = None if slots == work.samples else jnp.asarray(weight, self._target.dtype)
        if by_tiles:
            self._target = self._samples.in_storage_order(jnp.asarray(arrays.target, self._target.dtype))

    def prepare(self, operation: Operation) -> Run:
        if operation == "value_and_gradient":
            return self.compiled(operation)[0]
        plan = self._plan(operation)

        # Called as a user does, outside jit: the library compiles for itself, here.
        def run() -> Any:
            return jax.block_until_ready(shade_slots(self._scene, self._samples, plan=plan))

        run()
        return run

    def _plan(self, operation: Operation) -> Plan:
        free = operation == "value_and_gradient" or not self._skip
        return make_plan(self._scene, self._samples, self._options, free=True if free else ())

    def compiled(self, operation: Operation) -> tuple[Run, str]:
        """The operation compiled by a jit of its own, and the program that came out."""
        plan = self._plan(operation)
        free, fixed = split_fields(self._scene, self._kind, self._names)
        names = ("position_planes", "normal_planes", "color_planes") if self._by_samples else ()
        planes = {name: getattr(self._samples, name) for name in names}

        def loss(free: tuple[Scene, Any], fixed: Scene, samples: SampleBuffer, target: Any, weight: Any) -> Any:
            scene, own = eqx.combine(free[0], fixed), dataclasses.replace(samples, **free[1])
            if self._by_tiles:
                return sum_over_samples(lambda color, target: (color[:3] - target) ** 2, scene, own, target, plan=plan)
            squared = (shade_tiles(scene, own, plan=plan)[:, :3] - target) ** 2
            return jnp.sum(squared if weight is None else squared * weight)

        def colors(scene: Scene, samples: SampleBuffer) -> Any:
            return shade_slots(scene, samples, plan=plan)

        if operation == "forward":
            arguments: tuple[Any, ...] = (self._scene, self._samples)
            program = jax.jit(colors, compiler_options=compiler_options()).lower(*arguments).compile()
        else:
            arguments = ((free, planes), fixed, self._samples, self._target, self._weight)
            program = jax.jit(jax.value_and_grad(loss), compiler_options=compiler_options()).lower(*arguments).compile()
        return lambda: jax.block_until_ready(program(*arguments)), program.as_text() or ""

    def colors(self, result: Any) -> np.ndarray:
        return np.asarray(self._samples.in_sample_order(result, axis=0)).T[:3]

    def value_and_gradient(self, result: Any) -> ValueAndGradient:
        value, (gradient, _) = result
        fields = free_fields(gradient, self._kind)

        def rows(name: str) -> np.ndarray:
            array = np.asarray(fields[name])
            return array.sum(axis=0) if name.startswith("material.") else array

        return ValueAndGradient(float(value), {name: rows(name) for name in self._names})
