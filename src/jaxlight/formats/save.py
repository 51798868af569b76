"""A scene into an X3D file: into the text that it came from, with only the changed fields changed, or a new one."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from ..scene import Scene, nodes
from ..scene.checks import check_has_nodes
from ..tracing import refuse_traced
from .changes import changed_nodes, updated_children
from .limits import as_path
from .safe_write import check_place, written_whole
from .texture_files import TexturePlan, named_files, texture_url
from .x3d_editor import with_attributes
from .x3d_fields import fields_of
from .x3d_source import X3DSource
from .x3d_writer import all_nodes, write_x3d
from .xml_elements import parse_xml


def save(scene: Scene, path: str | Path) -> tuple[Path, ...]:
    """Write a scene as an X3D file in its XML encoding.

    A scene that was loaded from an X3D file is written into that file's text: only the attributes whose values changed
    are touched, and every other byte stays. A scene built in Python or loaded from a mesh is written anew. Numbers
    get the shortest digits that read back as the scene's own. A texture whose texels changed is written as a PNG beside
    the file (or into the PixelTexture), rounded to 8 bits; texture files that did not change are copied along. One that
    is gone, or holds another picture than was loaded, is written like a changed one.

    Args:
        scene: its leaves (materials, lights, fog, textures) say the values, its document where they belong.
        path: ends in .x3d. The file is replaced at once when everything is written; an error leaves it as it was.

    Returns:
        The files that were written: `path`, and those of textures beside it.

    Raises:
        ValueError: another suffix; a value out of its field's range; one node used several times (USE) whose rows now
            differ; a change that no field of the file can hold; traced numbers; the file at `path` is the one that the
            scene was read from, and was changed since (a SceneFileError).
        OSError: the folder of `path` does not exist, or the system refuses.
    """
    check_has_nodes("save: scene", scene)
    refuse_traced("save", scene)
    path = as_path("save: path", path)
    if path.suffix.lower() != ".x3d":
        raise ValueError(f"{path}: expected a name that ends in .x3d, the one format that is written")
    check_place(path)
    changes = changed_nodes(scene)
    source = scene.document.source
    if isinstance(source, X3DSource):
        source.check_unchanged(path)
        plan = TexturePlan(
            path, {*(file.path for file in source.texture_files.values()), *named_files(path, source.element_numbers)}
        )
        data = _edited_source(source, changes, plan)
    else:
        everything = all_nodes(scene.document.children)
        plan = TexturePlan(path, named_files(path, everything))
        data = _new_file(scene.document.children, everything, changes, plan)
    plan.carry_out()
    with written_whole(path) as draft:
        draft.write_bytes(data)
    if isinstance(source, X3DSource):
        source.note_saved(path, data)
    return (path, *plan.files)


def _edited_source(source: X3DSource, changes: dict[nodes.Node, nodes.Node], plan: TexturePlan) -> bytes:
    """The bytes of the file that the scene came from, with the changed fields in place."""
    edits: dict[int, dict[str, str]] = {}
    for node in source.element_numbers:
        new = changes.get(node, node)
        values = _changed_values(node, new, source.angle_unit) if new is not node else {}
        if isinstance(node, nodes.ImageTexture) and isinstance(new, nodes.ImageTexture):
            urls = texture_url(plan, node, new, source)
            if urls is not None:
                values["url"] = fields_of(nodes.ImageTexture)["url"].type.format(urls)
        if values:
            edits[source.element_numbers[node]] = values
    return with_attributes(source.path, source.data, edits) if edits else source.data


def _changed_values(node: nodes.Node, new: nodes.Node, angle_unit: float) -> dict[str, str]:
    """The attributes in which a node differs from its replacement, as text in the file's units."""
    return {
        attribute: field.type.format(field.in_file_units(getattr(new, field.name), angle_unit))
        for attribute, field in fields_of(type(node)).items()
        if getattr(new, field.name) is not getattr(node, field.name)
        and (field.name == "image" or getattr(new, field.name) != getattr(node, field.name))
    }


def _new_file(
    children: tuple[nodes.Node, ...],
    everything: list[nodes.Node],
    changes: dict[nodes.Node, nodes.Node],
    plan: TexturePlan,
) -> bytes:
    """A new file that holds the nodes with their changes."""
    replacements = dict(changes)
    for node in everything:
        new = changes.get(node, node)
        if isinstance(node, nodes.ImageTexture) and isinstance(new, nodes.ImageTexture):
            urls = texture_url(plan, node, new, None)
            if urls is not None:
                replacements[node] = dataclasses.replace(new, url=urls)
    data = write_x3d(updated_children(children, replacements))
    try:
        parse_xml(plan.path, data)
    except ValueError as error:
        raise ValueError(f"save: the scene cannot be written as XML: {error}") from None
    return data
