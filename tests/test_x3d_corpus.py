"""Real X3D files by others: all load, what is not known is named, and saving what did not change changes nothing."""

from __future__ import annotations

import csv
import dataclasses
import warnings
from pathlib import Path

import equinox as eqx
import jax
import numpy as np
import pytest

from jaxlight import Scene, SceneFileError, SceneFileWarning, load, save
from jaxlight.scene.nodes import nodes_equal

FOLDER = Path(__file__).parent / "data" / "x3d_scenes"
with (FOLDER / "manifest.csv").open() as manifest:
    ROWS = list(csv.DictReader(manifest))
XML = [row["file"] for row in ROWS if row["encoding"] == "xml"]
OTHERS = [(row["file"], row["encoding"]) for row in ROWS if row["encoding"] != "xml"]


def load_quietly(path: Path) -> Scene:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SceneFileWarning)
        return load(path)


def same_numbers(a: Scene, b: Scene) -> bool:
    ours, theirs = jax.tree.leaves(a), jax.tree.leaves(b)
    return len(ours) == len(theirs) and all(np.array_equal(x, y) for x, y in zip(ours, theirs, strict=True))


@pytest.mark.parametrize("name", XML)
def test_every_xml_file_loads_with_at_most_one_warning(name: str) -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = load(FOLDER / name)
    assert len(caught) <= 1
    assert all(warning.category is SceneFileWarning for warning in caught)
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(scene))


def test_the_corpus_is_not_mostly_skipped() -> None:
    shapes = {name: len(load_quietly(FOLDER / name).document.shapes) for name in XML}
    assert sum(shapes.values()) == 158
    # These hold nothing but prototypes, which are skipped and named.
    assert {Path(name).name for name, count in shapes.items() if count == 0} == {
        "27cubes.x3d",
        "NestedProtos.x3d",
        "Teapot.x3dv",
    }


@pytest.mark.parametrize(("name", "encoding"), OTHERS)
def test_other_encodings_get_an_error_that_names_them(name: str, encoding: str) -> None:
    said = {"vrml97": "VRML97", "x3dv": "classic VRML encoding"}[encoding]
    with pytest.raises(SceneFileError, match=f"{said}.*does not read yet"):
        load(FOLDER / name)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\x1f\x8b\x08\x00rest", "gzip"),
        (b'{ "X3D": { "Scene": {} } }', "JSON"),
        (b'{"asset": {"version": "2.0"}}', "glTF with separate files"),
        (b"\xe0\x00\x00\x01\x00\x00", "binary X3D"),
        (b"<!DOCTYPE html>\n<html></html>", "HTML"),
        (b"#X3D V3.3 utf8\n", "classic VRML"),
        (b"\xef\xbb\xbf#VRML V2.0 utf8\n", "VRML97"),
        (b"", "empty"),
        (b"hello", "unknown format"),
    ],
)
def test_the_content_says_the_encoding_whatever_the_name(tmp_path: Path, content: bytes, said: str) -> None:
    for suffix in (".x3d", ".wrl", ".dat"):
        path = tmp_path / f"scene{suffix}"
        path.write_bytes(content)
        if said == "unknown format" and suffix == ".x3d":
            continue
        with pytest.raises(SceneFileError, match=said):
            load(path)


def test_an_xml_file_with_another_suffix_is_read() -> None:
    assert load_quietly(FOLDER / "create3000/Tests/Components/Shape/Teapot.x3dv").document.source is not None


@pytest.mark.parametrize("name", XML)
def test_saving_an_unchanged_scene_gives_the_same_bytes(tmp_path: Path, name: str) -> None:
    save(load_quietly(FOLDER / name), tmp_path / "scene.x3d")
    assert (tmp_path / "scene.x3d").read_bytes() == (FOLDER / name).read_bytes()


@pytest.mark.parametrize("name", XML)
def test_saving_changed_numbers_and_loading_again_gives_them_back(tmp_path: Path, name: str) -> None:
    scene = load_quietly(FOLDER / name)
    rng = np.random.default_rng(7)

    def leaves(s: Scene) -> list:
        lights = [
            lights for lights in (s.point, s.spot, s.directional) if lights and not getattr(lights, "headlight", 0)
        ]
        materials = [s.materials.diffuse_color, s.materials.shininess] if s.materials else []
        return materials + [each for group in lights for each in (group.color, group.intensity)]

    # All rows alike: some files use one light twice.
    values = [np.broadcast_to(rng.random(x.shape[1:]), x.shape).astype(x.dtype) for x in leaves(scene)]
    changed = eqx.tree_at(leaves, scene, values)
    save(changed, tmp_path / "scene.x3d")
    assert same_numbers(load_quietly(tmp_path / "scene.x3d"), changed)


@pytest.mark.parametrize("name", XML)
def test_written_anew_and_loaded_again_the_nodes_are_equal(tmp_path: Path, name: str) -> None:
    scene = load_quietly(FOLDER / name)
    without_source = dataclasses.replace(scene, document=dataclasses.replace(scene.document, source=None))
    save(without_source, tmp_path / "scene.x3d")
    again = load_quietly(tmp_path / "scene.x3d")
    assert nodes_equal(again.document.children, scene.document.children)
    assert same_numbers(again, scene)
