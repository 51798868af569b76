"""XML -> plain elements that know their line. Entities are refused, nothing outside the file is opened."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any, NoReturn
from xml.sax import SAXParseException
from xml.sax.handler import ContentHandler
from xml.sax.xmlreader import Locator

from defusedxml import DefusedXmlException
from defusedxml.expatreader import DefusedExpatParser

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


class _Builder(ContentHandler):
    """Takes the parser's events and builds the tree.

    Names come as they are written: with namespaces in their place a short file could hold names of any length.
    """

    def __init__(self, path: Path, size: int, place: Locator) -> None:
        super().__init__()
        self.path = path
        self.place = place
        self.root: Element | None = None
        self.open: list[Element] = []
        self.count = 0
        self.left = size
        """Characters that start tags may still have: no more than the file, or DOCTYPE gives them what they lack."""

    def startElement(self, name: str, attrs: Any) -> None:
        if self.count >= MAX_ELEMENTS:
            self.refuse(f"more than {MAX_ELEMENTS} elements, the most that is read")
        if len(self.open) >= MAX_NESTING:
            self.refuse(f"elements nested deeper than {MAX_NESTING}")
        self.left -= len(name) + sum(map(len, attrs.keys())) + sum(map(len, attrs.values()))
        if self.left < 0:
            self.refuse("DOCTYPE declares attributes that are longer than the file")
        element = Element(_local(name), _own(attrs), self.place.getLineNumber() or 0, self.count)
        self.count += 1
        if self.open:
            self.open[-1].children.append(element)
        else:
            self.root = element
        self.open.append(element)

    def endElement(self, name: str) -> None:
        self.open.pop()

    def skippedEntity(self, name: str) -> None:
        self.refuse(f"malformed XML: undefined entity &{name};")

    def refuse(self, why: str) -> NoReturn:
        raise SceneFileError(self.path, self.place.getLineNumber(), why)


def _own(attributes: Any) -> dict[str, str]:
    """Without namespaces and what is of them: an attribute of X3D's own has no prefix."""
    return {name: value for name, value in attributes.items() if ":" not in name and name != "xmlns"}


def _local(name: str) -> str:
    """A name without its namespace (`x3d:Shape` -> `Shape`)."""
    return name.rpartition(":")[2]


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
    parser = DefusedExpatParser(forbid_external=False)  # a document type is named in many files; it is never fetched
    builder = _Builder(path, len(data), parser)
    parser.setContentHandler(builder)
    try:
        parser.feed(data)
        parser.close()
    except SceneFileError:
        raise
    except SAXParseException as error:
        raise SceneFileError(path, error.getLineNumber(), f"malformed XML: {error.getMessage()}") from None
    except DefusedXmlException as error:
        raise SceneFileError(path, parser.getLineNumber(), f"entities are not read: {type(error).__name__}") from None
    except (LookupError, ValueError) as error:  # an encoding that Python does not know, or a multi-byte one
        raise SceneFileError(path, 1, f"malformed XML: {error}") from None
    if builder.root is None:
        raise SceneFileError(path, None, "malformed XML: no element")
    return builder.root
