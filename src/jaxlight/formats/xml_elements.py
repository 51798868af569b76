"""XML -> plain elements that know their line. Entities are refused, nothing outside the file is opened."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from xml.etree.ElementTree import ParseError
from xml.parsers import expat

from defusedxml import DefusedXmlException
from defusedxml.ElementTree import DefusedXMLParser

from .errors import SceneFileError
from .limits import MAX_ELEMENTS, MAX_NESTING

_FORBIDDEN = re.compile("[^\\t\\n\\r -\\ud7ff\\ue000-\\ufffd\U00010000-\U0010ffff]")


@dataclasses.dataclass(slots=True, eq=False)
class Element:
    """One XML element: its tag without a namespace, its own attributes, the line and number of its start tag."""

    tag: str
    attributes: dict[str, str]
    line: int
    number: int
    """How many start tags stand before this one in the file."""
    children: list[Element] = dataclasses.field(default_factory=list)


class _Builder:
    """Takes the parser's events and builds the tree."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.parser: expat.XMLParserType | None = None
        self.root: Element | None = None
        self.open: list[Element] = []
        self.count = 0

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        line = self.parser.CurrentLineNumber if self.parser else 0
        if self.count >= MAX_ELEMENTS:
            raise SceneFileError(self.path, line, f"more than {MAX_ELEMENTS} elements, the most that is read")
        if len(self.open) >= MAX_NESTING:
            raise SceneFileError(self.path, line, f"elements nested deeper than {MAX_NESTING}")
        element = Element(_local(tag), _own(attributes), line, self.count)
        self.count += 1
        if self.open:
            self.open[-1].children.append(element)
        else:
            self.root = element
        self.open.append(element)

    def end(self, tag: str) -> None:
        self.open.pop()

    def close(self) -> None:
        """The parser asks for it at the end."""


def _own(attributes: dict[str, str]) -> dict[str, str]:
    """Without those of other namespaces: an attribute of X3D's own has no prefix."""
    return {name: value for name, value in attributes.items() if not name.startswith("{")}


def _local(name: str) -> str:
    """A name without its namespace (`{uri}Shape` -> `Shape`)."""
    return name.rpartition("}")[2]


def xml_text(text: str) -> str:
    """The text with `_` for each character that XML 1.0 cannot hold (its clause 2.2)."""
    return _FORBIDDEN.sub("_", text)


def parse_xml(path: Path, data: bytes) -> Element:
    """The root element of an XML document.

    The parser gets all bytes at once: fed in pieces, it reads a long attribute again with every piece.

    Raises:
        SceneFileError: malformed XML, an entity declaration, too many elements or too deep a nesting; with the line.
    """
    if data.startswith((b"<\0", b"\0<")):
        raise SceneFileError(path, 1, "UTF-16 without a byte order mark")
    builder = _Builder(path)
    parser = DefusedXMLParser(target=builder)
    builder.parser = parser.parser
    try:
        parser.feed(data)
        parser.close()
    except SceneFileError:
        raise
    except ParseError as error:
        line = error.position[0]
        raise SceneFileError(path, line, f"malformed XML: {str(error).partition(': line')[0]}") from None
    except DefusedXmlException as error:
        line = parser.parser.CurrentLineNumber
        raise SceneFileError(path, line, f"entities are not read: {type(error).__name__}") from None
    except (LookupError, ValueError) as error:  # an encoding that Python does not know, or a multi-byte one
        raise SceneFileError(path, 1, f"malformed XML: {error}") from None
    if builder.root is None:
        raise SceneFileError(path, None, "malformed XML: no element")
    return builder.root
