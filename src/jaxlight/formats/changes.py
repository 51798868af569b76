"""The numbers of a scene back into nodes: which fields differ from what the scene's nodes say."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..scene import Scene, Surface, nodes
from ..scene.flags import Flags
from .x3d_values import float_text

_ROWS = ("materials", "directional", "point", "spot")
"""Tables of a scene, each with a row for every node that the document keeps under the same name."""
_CHANGE_NODES = "which follows from the scene's nodes; change those instead"


def changed_nodes(scene: Scene) -> dict[nodes.Node, nodes.Node]:
    """The nodes of `scene.document` whose fields the scene's leaves no longer agree with, each with its replacement.

    A number that a leaf only rounded (0.1 as float32) has not changed. A changed one becomes the shortest decimal that
    reads back as the leaf's number, so a file stays as exact and as readable as it can be.

    Raises:
        ValueError: a number outside its field's range; rows of one node (USE) that differ; a change that no field of a
            node can hold (the headlight, a light's frame or scope, a surface, a name, rows added or removed).
    """
    document = scene.document
    changes: dict[Any, dict[str, Any]] = {}
    for kind in _ROWS:
        rows, group = getattr(document, kind), getattr(scene, kind)
        if bool(rows) != (group is not None):
            raise ValueError("save: the scene has other kinds of lights or materials than the nodes that it came from")
        if rows:
            for node, field, value in _changed_rows(rows, group):
                changes.setdefault(node, {})[field] = value
    if (document.fog is None) != (scene.fog is None):
        raise ValueError("save: fog was added to or removed from the scene; change its nodes instead")
    if document.fog is not None:
        changes |= {document.fog: _changed_fog(document.fog, scene.fog)}
    if len(document.textures) != len(scene.textures):
        raise ValueError("save: textures were added to or removed from the scene; change its nodes instead")
    if len(scene.surfaces) != len({placed.surface for placed in document.shapes}):
        raise ValueError("save: surfaces were added to or removed from the scene; change its nodes instead")
    _check_what_nodes_say(scene)
    for node, texture in zip(document.textures, scene.textures, strict=True):
        image = np.asarray(texture.image)
        if not _same(image, node.image):
            changes.setdefault(node, {})["image"] = image.astype(np.float64)
    return {node: dataclasses.replace(node, **fields) for node, fields in changes.items() if fields}


def updated_children(
    children: tuple[nodes.Node, ...], replacements: dict[nodes.Node, nodes.Node]
) -> tuple[nodes.Node, ...]:
    """The tree with some nodes replaced; a node that appears twice stays one."""
    done: dict[nodes.Node, nodes.Node] = {}

    def updated(node: nodes.Node) -> nodes.Node:
        if node not in done:
            new = replacements.get(node, node)
            fields: dict[str, Any] = {}
            for name in new.accepts:
                value = getattr(new, name)
                if isinstance(value, tuple):
                    fields[name] = tuple([updated(child) for child in value])
                elif value is not None:
                    fields[name] = updated(value)
            moved = any(not _identical(getattr(new, name), value) for name, value in fields.items())
            done[node] = dataclasses.replace(new, **fields) if moved else new  # type: ignore[type-var]  # a dataclass
        return done[node]

    return tuple([updated(child) for child in children])


def _identical(a: Any, b: Any) -> bool:
    """The same nodes, not only nodes that are alike."""
    if isinstance(a, tuple) and isinstance(b, tuple):
        return len(a) == len(b) and all(x is y for x, y in zip(a, b, strict=True))
    return a is b


def _changed_rows(rows: tuple[Any, ...], group: Any) -> Iterator[tuple[nodes.Node, str, Any]]:
    """(node, field, new value) of the rows of a struct of arrays that differ from their nodes."""
    headlight = getattr(group, "headlight", False)
    for field in _shared_fields(rows[0], group):
        leaf = _array(getattr(group, field))
        before = np.asarray([getattr(node, field) for node in rows])
        if leaf.shape != before.shape:
            raise ValueError(f"save: {type(rows[0]).__name__}.{field}: expected shape {before.shape}, got {leaf.shape}")
        differs = ~_agrees(leaf, before).reshape(len(rows), -1).all(axis=1)
        rows_of: dict[nodes.Node, list[int]] = {}
        for row in np.flatnonzero(differs).tolist():
            rows_of.setdefault(rows[row], [])
        for row, node in enumerate(rows):
            if node in rows_of:
                rows_of[node].append(row)
        for node, own in rows_of.items():
            where = f"{node.label}.{field}"
            if headlight and own[-1] == len(rows) - 1:
                raise ValueError(f"save: {where} changed, but the headlight is the browser's: no file can hold it; "
                                 "give the scene a DirectionalLight")  # fmt: skip
            if any(not np.array_equal(leaf[row], leaf[own[0]], equal_nan=True) for row in own[1:]):
                raise ValueError(f"save: {where}: the node is used {len(own)} times (USE) and its values now differ")
            yield node, field, _field_value(leaf[own[0]], before[own[0]])


def _changed_fog(node: nodes.Fog, fog: Any) -> dict[str, Any]:
    fields = {name: np.asarray(getattr(fog, name)) for name in ("color", "visibility_range")}
    changed = {
        name: _field_value(leaf, np.asarray(getattr(node, name)))
        for name, leaf in fields.items()
        if not _same(leaf, getattr(node, name))
    }
    return changed if fog.fog_type == node.fog_type else {**changed, "fog_type": fog.fog_type}


def _shared_fields(node: nodes.Node, group: Any) -> list[str]:
    """The fields that a node class and the struct of arrays of its kind have in common."""
    own = {field.name for field in dataclasses.fields(node)}  # type: ignore[arg-type]  # a dataclass
    return [field.name for field in dataclasses.fields(group) if field.name in own]


def _array(leaf: Any) -> np.ndarray:
    return leaf.array if isinstance(leaf, Flags) else np.asarray(leaf)


def _agrees(leaf: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Where a leaf holds what the node says, as far as the leaf's precision goes."""
    return leaf == before.astype(leaf.dtype)


def _same(leaf: np.ndarray, value: Any) -> bool:
    before = np.asarray(value)
    return leaf.shape == before.shape and bool(np.all(_agrees(leaf, before)))


def _field_value(new: Any, before: Any) -> Any:
    """A node's field value from a leaf: where it agrees with the old value the old one's digits are kept."""
    if np.asarray(new).dtype == bool:
        return bool(new)
    kept = _agrees(np.asarray(new), np.asarray(before))
    numbers = [
        float(old) if keep else float(float_text(number))
        for number, old, keep in zip(np.ravel(new), np.ravel(before), np.ravel(kept), strict=True)
    ]
    return tuple(numbers) if np.ndim(new) else numbers[0]


def _check_what_nodes_say(scene: Scene) -> None:
    """Refuse changes of what follows from the nodes and where they stand: no number in a field of theirs holds them."""
    original = Scene.from_nodes(scene.document.children)
    pairs = [(kind, getattr(scene, kind), getattr(original, kind)) for kind in (*_ROWS, "fog")]
    for kind in ("surfaces", "textures"):
        each = zip(getattr(scene, kind), getattr(original, kind), strict=True)
        pairs += [(f"{kind}[{row}]", now, before) for row, (now, before) in enumerate(each)]
    for where, part, original_part in pairs:
        for field in (*Surface._fields, "names", "name", "headlight"):
            now, before = (getattr(each, field, None) for each in (part, original_part))
            if now != before:
                raise ValueError(f"save: {where}.{field} changed from {before!r:.60} to {now!r:.60}, {_CHANGE_NODES}")
    for kind in ("directional", "point", "spot", "fog"):
        for name in ("to_world", "to_local", "in_scope"):
            leaf, before = (_array(getattr(getattr(each, kind), name, None)) for each in (scene, original))
            precision = min(leaf.dtype, before.dtype, key=lambda dtype: dtype.itemsize)
            if leaf.shape != before.shape or not np.array_equal(leaf.astype(precision), before.astype(precision)):
                raise ValueError(f"save: {kind}.{name} changed, {_CHANGE_NODES}")
