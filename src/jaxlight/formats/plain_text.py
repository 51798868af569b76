"""Text files that do not say how they are encoded."""

from __future__ import annotations

import re

_MARKS = ((b"\xef\xbb\xbf", "utf-8"), (b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be"))
_COMMENT = re.compile(r"(?:^|\s)#(?:\s.*)?$")


def text_of(data: bytes) -> str:
    """By its byte order mark, or else UTF-8, or Latin-1, in which every byte is a letter; lines end in a line feed."""
    mark, codec = next((pair for pair in _MARKS if data.startswith(pair[0])), (b"", "utf-8"))
    data = data[len(mark) :]
    try:
        text = data.decode(codec)
    except UnicodeDecodeError:
        text = data.decode("latin-1") if codec == "utf-8" else data.decode(codec, errors="replace")
    return text.replace("\r\n", "\n").replace("\r", "\n")


def name_in(rest: str) -> str:
    """A name that ends a statement, without a comment behind it; a name may have a # in it, as in `Material #25`."""
    return " ".join(_COMMENT.sub("", rest).split())
