"""Rows of a ply: read as they stand, or an error that names them; never cut to a type, nor taken for other rows."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from jaxlight import SceneFileError, load

PLACES = [(i, i % 3, i % 5) for i in range(8)]
HEADER = """ply
format {form} 1.0
element vertex {vertices}
property {place} x
property float y
property float z
{more}element face {faces}
property list {size} {corner} vertex_indices
end_header
"""


def header(form: str = "ascii", *, vertices: int = 3, faces: int = 1, place: str = "float", size: str = "uchar",
           corner: str = "int", more: str = "") -> str:  # fmt: skip
    return HEADER.format(**locals())


def binary(order: str, faces: list[tuple[int, ...]], corner: str = "int", code: str = "i") -> bytes:
    form = {"<": "binary_little_endian", ">": "binary_big_endian"}[order]
    rows = [struct.pack(f"{order}3f", *place) for place in PLACES]
    rows += [struct.pack(f"{order}B{len(face)}{code}", len(face), *face) for face in faces]
    return header(form, vertices=len(PLACES), faces=len(faces), corner=corner).encode() + b"".join(rows)


def loaded(folder: Path, data: bytes | str) -> np.ndarray:
    """The corners [T, 3] of a ply of these bytes."""
    (folder / "a.ply").write_bytes(data.encode() if isinstance(data, str) else data)
    return load(folder / "a.ply").document.shapes[0].node.geometry.coord_index.reshape(-1, 4)[:, :3]


@pytest.mark.parametrize("order", ["<", ">"])
def test_faces_of_a_binary_ply_whose_sizes_make_up_for_one_another_are_refused(tmp_path: Path, order: str) -> None:
    """Four corners, three and five take the room of three times four."""
    with pytest.raises(SceneFileError, match=r"a.ply: the lists vertex_indices are of 4 entries and, of face 1, of 3"):
        loaded(tmp_path, binary(order, [(0, 1, 2, 3), (4, 5, 6), (0, 2, 4, 6, 7)]))
    np.testing.assert_array_equal(loaded(tmp_path, binary(order, [(0, 1, 2), (4, 5, 6)])), [(0, 1, 2), (4, 5, 6)])


def test_corners_of_a_binary_ply_that_are_no_whole_numbers_are_refused(tmp_path: Path) -> None:
    np.testing.assert_array_equal(loaded(tmp_path, binary("<", [(0, 1, 2)], "float", "f")), [(0, 1, 2)])
    data = binary("<", [(0, 1, 2)], "float", "f")[:-4] + struct.pack("<f", 1.5)
    with pytest.raises(SceneFileError, match=r"a.ply: a face has the index 1.5, expected a whole number"):
        loaded(tmp_path, data)


@pytest.mark.parametrize(
    ("cut", "said"),
    [(1, "its length is not that"), (4, "its length is"), (13, "announces 1 face, but holds none"), (20, "its length")],
)
def test_a_binary_ply_that_is_cut_off_is_refused(tmp_path: Path, cut: int, said: str) -> None:
    with pytest.raises(SceneFileError, match=said):
        loaded(tmp_path, binary("<", [(0, 1, 2)])[:-cut])


COLORS = "property {0} red\nproperty {0} green\nproperty {0} blue\n"


@pytest.mark.parametrize(
    ("head", "first", "said"),
    [
        (header(place="uchar"), "300 0 0", "a vertex has x 300, expected a whole number from 0 to 255"),
        (header(place="int"), "1.7 0 0", "a vertex has x 1.7, expected a whole number from -2147483648 to 2147483647"),
        (header(more=COLORS.format("uchar")), "0 0 0 300 0 0", "a vertex has red 300, expected a whole number"),
        (header(more=COLORS.format("uchar")), "0 0 0 0 -1 0", "a vertex has green -1, expected a whole number"),
        (header(more=COLORS.format("uchar")), "0 0 0 0 0 0.5", "a vertex has blue 0.5, expected a whole number"),
    ],
)
def test_numbers_that_their_type_does_not_hold_are_refused_with_line(
    tmp_path: Path, head: str, first: str, said: str
) -> None:
    end = " 0 0 0" if "red" in head else ""
    with pytest.raises(SceneFileError, match=rf"a.ply:{head.count(chr(10)) + 1}: {said}"):
        loaded(tmp_path, f"{head}{first}\n1 0 0{end}\n0 1 0{end}\n3 0 1 2\n")


def test_an_index_that_its_type_would_cut_is_refused(tmp_path: Path) -> None:
    rows = "".join(f"{i} {i % 3} {i % 5}\n" for i in range(300))
    with pytest.raises(SceneFileError, match="a face has vertex_indices 290, expected a whole number from 0 to 255"):
        loaded(tmp_path, f"{header(vertices=300, corner='uchar')}{rows}3 0 1 290\n")


def test_colors_of_wider_integers_are_clamped_not_cut(tmp_path: Path) -> None:
    rows = "0 0 0 300 -1 51\n1 0 0 255 0 0\n0 1 0 0 0 0\n3 0 1 2\n"
    (tmp_path / "a.ply").write_text(header(more=COLORS.format("int")) + rows)
    with pytest.warns(UserWarning, match=r"clamped 1 value .* colours of vertices \(-0.00392157 to 1.17647\)"):
        scene = load(tmp_path / "a.ply")
    colors = scene.document.shapes[0].node.geometry.color.color
    np.testing.assert_allclose(colors, [(1, 0, 0.2), (1, 0, 0), (0, 0, 0)])


@pytest.mark.parametrize(
    ("before", "after", "said"),
    [
        (
            "element face",
            "element$face",
            r"a.ply:7: expected format, element, property or comment, got 'element\$face 1'",
        ),
        ("property float y", "property float x", "a.ply:5: a second property x of the element vertex"),
        ("end_header", "element face 1\nend_header", "a.ply:9: a second element face"),
        (
            "end_header",
            "property list uchar int vertex_index\nend_header",
            "a.ply:7: the faces have corners twice, vertex_indices and vertex_index",
        ),
    ],
)
def test_a_header_that_says_a_thing_twice_or_in_unknown_words_is_refused(
    tmp_path: Path, before: str, after: str, said: str
) -> None:
    with pytest.raises(SceneFileError, match=said):
        loaded(tmp_path, header().replace(before, after, 1) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
