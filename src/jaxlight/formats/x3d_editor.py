"""Changes the values of some attributes in the text of an X3D file and leaves every other byte as it is."""

from __future__ import annotations

import re
from pathlib import Path
from xml.sax.saxutils import escape

from .xml_elements import Element, parse_xml

_MARKUP = re.compile(
    r"""<!--.*?-->|<!\[CDATA\[.*?\]\]>|<\?.*?\?>
    |<!DOCTYPE(?:[^\["'>]++|"[^"]*+"|'[^']*+')*+(?:\[(?:<!--.*?-->|<\?.*?\?>|[^\]"']|"[^"]*+"|'[^']*+')*+\]\s*+)?>
    |</[^>]*+>
    |<(?P<tag>[^\s/>!?]++)(?P<attributes>(?:[^>"']++|"[^"]*+"|'[^']*+')*+)>""",
    re.DOTALL | re.VERBOSE,
)
_ATTRIBUTE = re.compile(r"""([^\s=]+)\s*=\s*(?:"([^"]*)"|'([^']*)')""")
_DECLARED_ENCODING = re.compile(rb"""<\?xml[^>]*?encoding\s*=\s*["']([\w.:-]+)""")

_UTF8_MARK = b"\xef\xbb\xbf"


def with_attributes(path: Path, data: bytes, edits: dict[int, dict[str, str]]) -> bytes:
    """The file with some attributes set.

    Args:
        path: names the file in messages.
        data: a well-formed XML document.
        edits: number of a start tag in the file -> {attribute: its value}. An attribute that the tag lacks is added.

    Raises:
        ValueError: the result would differ from the file in more than these attributes.
    """
    mark = _UTF8_MARK if data.startswith(_UTF8_MARK) else b""
    codec = _codec(data.removeprefix(mark))
    try:
        text = data.removeprefix(mark).decode(codec)
    except (LookupError, UnicodeError):
        raise ValueError(f"{path}: its text cannot be changed in place: it is not {codec}") from None
    parts, end, number = [], 0, 0
    for match in _MARKUP.finditer(text):
        if match["tag"] is None:
            continue
        if number in edits:
            parts += [text[end : match.start("attributes")], _edited(match["attributes"], edits[number])]
            end = match.end("attributes")
        number += 1
    # What the file's encoding does not hold is written as a reference to the character.
    edited = mark + "".join([*parts, text[end:]]).encode(codec, "xmlcharrefreplace")
    if mark + text.encode(codec) != data or not _differs_only_by(path, data, edited, edits):
        raise ValueError(f"{path}: its text cannot be changed in place")
    return edited


def _edited(attributes: str, values: dict[str, str]) -> str:
    """The attributes of a start tag with new values; quotes and blanks stay."""
    missing = dict(values)
    parts, end, last = [], 0, 0
    for match in _ATTRIBUTE.finditer(attributes):
        last = match.end()
        if match[1] in missing:
            quote = attributes[match.end() - 1]
            start = last - 1 - len(match[2] or match[3] or "")
            parts += [attributes[end:start], _quoted(missing.pop(match[1]), quote)]
            end = last - 1
    parts.append(attributes[end:last])
    quote = attributes[last - 1] if last else "'"
    parts += [f" {name}={quote}{_quoted(value, quote)}{quote}" for name, value in missing.items()]
    return "".join([*parts, attributes[last:]])


def _quoted(value: str, quote: str) -> str:
    return escape(value, {'"': "&quot;"} if quote == '"' else {"'": "&apos;"})


def _codec(data: bytes) -> str:
    """The encoding of an XML document, as the parser takes it: what a document declares goes before a UTF-8 mark.

    The mark of UTF-16 stays a character of the text.
    """
    for mark, codec in ((b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be")):
        if data.startswith(mark):
            return codec
    declared = _DECLARED_ENCODING.match(data)
    return declared[1].decode("ascii") if declared else "utf-8"


def _differs_only_by(path: Path, before: bytes, after: bytes, edits: dict[int, dict[str, str]]) -> bool:
    """True if reading `after` gives the elements of `before` with exactly these attributes set."""
    old, new = _in_file_order(parse_xml(path, before)), _in_file_order(parse_xml(path, after))
    return len(old) == len(new) and all(
        a.tag == b.tag and {**a.attributes, **edits.get(a.number, {})} == b.attributes
        for a, b in zip(old, new, strict=True)
    )


def _in_file_order(root: Element) -> list[Element]:
    found, stack = [], [root]
    while stack:
        element = stack.pop()
        found.append(element)
        stack.extend(reversed(element.children))
    return found
