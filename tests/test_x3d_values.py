"""X3D field values <-> text: exact, strict, and linear in the length of the text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxlight.formats import x3d_values as values
from jaxlight.formats import xml_elements
from jaxlight.formats.x3d_reader import read_x3d


@pytest.mark.parametrize("filler", ["", " 0" * 600], ids=["word by word", "all at once"])
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1 2 3", [1, 2, 3]),
        (" 1,2 ,\n\t3\r\n", [1, 2, 3]),
        ("+.5 -5. 1e3 -1.25E-2", [0.5, -5, 1000, -0.0125]),
        ("0.1 1e-320 1.7976931348623157e308", [0.1, 1e-320, 1.7976931348623157e308]),
    ],
)
def test_floats_are_read_exactly(text: str, expected: list[float], filler: str) -> None:
    assert values.parse_floats(text + filler)[: len(expected)].tolist() == expected


@pytest.mark.parametrize("filler", ["", " 0" * 600], ids=["word by word", "all at once"])
@pytest.mark.parametrize("word", ["x", "1.2.3", "1-2", "0x10", "nan", "inf", "1e", "1_000", "--1", "٣", "."])
def test_words_that_are_no_numbers_are_refused_by_name(word: str, filler: str) -> None:
    with pytest.raises(ValueError, match="is not a number") as caught:
        values.parse_floats(f"1 {word} 2{filler}")
    assert repr(word) in str(caught.value)


@pytest.mark.parametrize("filler", ["", " 0" * 600], ids=["word by word", "all at once"])
def test_integers_may_be_hexadecimal_and_must_be_whole(filler: str) -> None:
    assert values.parse_integers("0xFF -1 007" + filler)[:3].tolist() == [255, -1, 7]
    with pytest.raises(ValueError, match=r"'1\.5' is not an integer"):
        values.parse_integers("1.5" + filler)
    with pytest.raises(ValueError, match="too large"):
        values.parse_integers("0xFFFFFFFFFFFFFFFFFF" + filler)


def test_no_numbers() -> None:
    assert values.parse_floats(" ,\n").shape == (0,)
    assert values.parse_floats(" " * 1000).shape == (0,)


@pytest.mark.parametrize(
    ("field_type", "text", "message"),
    [
        (values.SFVec3f, "1 2", "expected 3 numbers, got 2"),
        (values.SFFloat, "", "expected 1 number, got 0"),
        (values.ROWS[3], "1 2 3 4", "expected groups of 3 numbers, got 4 numbers"),
        (values.SFBool, "yes", "expected true or false, got 'yes'"),
        (values.MFString, '"a" b', "expected strings in double quotes, got 'b'"),
        (values.SFImage, "2 2 1 0 0 0", "2 x 2 pixels announced, 3 given"),
        (values.SFImage, "1 1 1 256", "must lie in 0 to 0xff"),
        (values.SFImage, "1 1 1 -1", "must lie in 0 to 0xff"),
        (values.MFInt32, "0 " * 512 + str(2**63), "is too large"),
        (values.SFImage, "1 1 5 0", "0 to 4 components, got 1 1 5"),
        (values.SFImage, "99999 99999 1 0", "at most 67108864 are read"),
    ],
)
def test_wrong_values_say_what_came(field_type: values.FieldType, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message.replace("(", r"\(")):
        field_type.parse(text)


def test_strings_with_quotes_and_backslashes() -> None:
    assert values.MFString.parse(r'"a b" , "c\"d" "e\\f"') == ("a b", 'c"d', "e\\f")
    assert values.MFString.parse("plain.png") == ("plain.png",)
    strings = ("", "\\", '"', "a\nb", "ü")
    assert values.MFString.parse(values.MFString.format(strings)) == strings


@given(st.floats(allow_nan=False))
def test_every_double_survives_writing_and_reading(x: float) -> None:
    assert values.parse_floats(values.float_text(x)).tolist() == [x]


@given(st.integers(0, 2**32 - 1))
def test_every_float32_survives_in_as_few_digits_as_it_needs(bits: int) -> None:
    x = np.array([bits], dtype=np.uint32).view(np.float32)[0]
    if np.isnan(x):
        return
    text = values.float_text(x)
    assert np.float32(values.parse_floats(text)[0]) == x
    assert len(text) <= len(repr(float(x))) or "e" in text


def test_written_digits_are_short() -> None:
    assert values.float_text(np.float32(0.1)) == "0.1"
    assert values.float_text(2.0) == "2"
    assert values.ROWS[3].format(np.array([[0.1, 1, -0.5], [0, 0, 1e-9]])) == "0.1 1 -0.5, 0 0 1e-09"


@pytest.mark.parametrize("components", [1, 2, 3, 4])
def test_images_keep_their_rows_and_components(components: int) -> None:
    rng = np.random.default_rng(components)
    image = rng.integers(0, 256, (3, 2, components)) / 255.0
    assert np.array_equal(values.parse_image(values.format_image(image)), image)


def test_the_first_pixel_is_the_lower_left_one_and_red_comes_first() -> None:
    image = values.parse_image("2 2 3 0xFF0000 65280 0x0000FF 0xFFFFFF")
    assert image is not None
    assert image.tolist() == [[[1, 0, 0], [0, 1, 0]], [[0, 0, 1], [1, 1, 1]]]
    assert values.parse_image("0 0 0") is None


def test_a_long_attribute_is_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fed in pieces, the parser would read it again with every piece."""
    fed = []

    class Noting(xml_elements.DefusedExpatParser):
        def feed(self, data: bytes, isFinal: bool = False) -> None:  # its base class calls it so
            fed.append(len(data))
            super().feed(data, isFinal)

    monkeypatch.setattr(xml_elements, "DefusedExpatParser", Noting)
    numbers = " ".join(["-0.123456 1.5 2"] * 300_000)
    document = f"<X3D><Scene><Shape><TriangleSet><Coordinate point='{numbers}'/></TriangleSet></Shape></Scene></X3D>"
    ((shape,), _, _) = read_x3d(Path("many.x3d"), document.encode())
    assert fed == [len(document), 0]  # and that it is the end
    point = shape.geometry.coord.point
    np.testing.assert_array_equal(point, np.broadcast_to([-0.123456, 1.5, 2.0], (300_000, 3)))
