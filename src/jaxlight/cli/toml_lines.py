"""On which line of a TOML file each key stands; the standard library's reader does not tell."""

from __future__ import annotations

import re
import tomllib

Key = tuple[str | int, ...]
"""Names of tables and keys, and positions in arrays: `("views", 1, "mask")`."""

_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_SPACE = re.compile(r"[ \t]*")
_NAME = re.compile(r"[A-Za-z0-9_-]+|\"(?:\\.|[^\"\\\n])*\"|'[^'\n]*'")
_SCALAR = re.compile(
    r'"""(?:\\.|[^\\])*?"{3,5}'
    r"|'''.*?'{3,5}"
    r'|"(?:\\.|[^"\\\n])*"'
    r"|'[^'\n]*'"
    r"|\d{4}-\d{2}-\d{2} \d[^\s,\]}#]*"
    r"|[^\s,\]}#]+",
    re.DOTALL,
)


def key_lines(text: str) -> dict[Key, int]:
    """Line (from 1) of every table, key and array element of a text that `tomllib` accepts."""
    return _Walk(text).lines


class _Walk:
    """One pass over the text, which is known to be right: only where things stand is asked."""

    def __init__(self, text: str) -> None:
        self.text, self.at = text, 0
        self.lines: dict[Key, int] = {}
        self.lengths: dict[Key, int] = {}
        """Tables so far in each array of tables."""
        table: Key = ()
        while self._skip(_BLANK) < len(text):
            if text.startswith("[", self.at):
                table = self._header()
            else:
                self._pair(table)

    def _skip(self, pattern: re.Pattern[str]) -> int:
        match = pattern.match(self.text, self.at)
        self.at = match.end() if match else self.at
        return self.at

    def _note(self, key: Key, at: int) -> None:
        self.lines.setdefault(key, self.text.count("\n", 0, at) + 1)

    def _names(self) -> list[str]:
        """A dotted key; leaves the position behind it and the space that follows."""
        names = []
        while True:
            self._skip(_SPACE)
            match = _NAME.match(self.text, self.at)
            assert match is not None
            quoted = match[0][0] in "\"'"
            names.append(tomllib.loads(f"name = {match[0]}")["name"] if quoted else match[0])
            self.at = match.end()
            self._skip(_SPACE)
            if not self.text.startswith(".", self.at):
                return names
            self.at += 1

    def _header(self) -> Key:
        begin = self.at
        is_array = self.text.startswith("[[", self.at)
        self.at += 2 if is_array else 1
        names = self._names()
        self.at += 2 if is_array else 1
        key: Key = ()
        for position, name in enumerate(names):
            key = (*key, name)
            self._note(key, begin)
            if is_array and position == len(names) - 1:
                self.lengths[key] = self.lengths.get(key, 0) + 1
            if key in self.lengths:
                key = (*key, self.lengths[key] - 1)
                self._note(key, begin)
        return key

    def _pair(self, table: Key) -> None:
        begin = self.at
        key = table
        for name in self._names():
            key = (*key, name)
            self._note(key, begin)
        self.at += 1  # the equals sign
        self._skip(_SPACE)
        self._value(key)

    def _value(self, key: Key) -> None:
        opening = self.text[self.at]
        if opening not in "[{":
            self._skip(_SCALAR)
            return
        self.at += 1
        position = 0
        while True:
            self._skip(_BLANK)
            if self.text[self.at] in "]}":
                self.at += 1
                return
            if self.text[self.at] == ",":
                self.at += 1
            elif opening == "{":
                self._pair(key)
            else:
                self._note((*key, position), self.at)
                self._value((*key, position))
                position += 1
