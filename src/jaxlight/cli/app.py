"""Parsing, dispatch and the exit status: 0 success, 1 ran without success, 2 bad input, 130 interrupted."""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
import traceback
import warnings
from collections.abc import Sequence
from typing import Any

import tyro

from .fit import Fit
from .gradcheck import Gradcheck
from .info import Info
from .render import Render
from .status import BAD_INPUT, FAILURE, INTERRUPTED, SUCCESS
from .stress import Stress

COMMANDS = {"info": Info, "render": Render, "fit": Fit, "gradcheck": Gradcheck, "stress": Stress}

_MISREAD = {
    r"invalid literal for int\(\) with base 10: ('.*')": "a whole number",
    r"could not convert string to float: ('.*')": "a number",
    r"no type matching \{None\}\|INT could be instantiated from \[('.*')\]": "a whole number",
    r"no type matching \{None\}\|FLOAT could be instantiated from \[('.*')\]": "a number",
}
"""What Python and tyro say of words that are no numbers, and what they expected."""

HELP = """\
usage: jaxlight COMMAND [OPTIONS]

Differentiable VRML97 / X3D lighting: look into a scene, render it, fit its materials and lights to pictures.

commands:
{commands}

`jaxlight COMMAND --help` explains a command and its options. A first walk, with an X3D file or a mesh:

  jaxlight info scene.x3d
  jaxlight render scene.x3d --output scene.png
  jaxlight fit scene.x3d photo.png --free 'Material[*].diffuse_color' --output fitted

exit status: 0 success; 1 ran, but without success (a fit that did not converge, a derivative that disagrees,
a figure that does not hold); 2 bad input, said in one line on stderr (JAXLIGHT_TRACEBACK=1 shows where it was found);
130 interrupted."""


def main(args: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        args: the words after `jaxlight`; default: the process's own.

    Returns:
        The exit status.
    """
    warnings.showwarning = _show_warning
    words = list(sys.argv[1:] if args is None else args)
    try:
        status = _help(words) if words[:1] in (["-h"], ["--help"], ["--version"]) else _parse(words).run()
        sys.stdout.flush()
        return status
    except KeyboardInterrupt:
        return _complain("interrupted", INTERRUPTED)
    except BrokenPipeError:
        # The reader of our output went away (`| head`). Nothing is left to say, also not at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILURE
    except (ValueError, OSError, ImportError) as error:
        if isinstance(error, ImportError) and error.name is not None:
            raise  # not one of ours, which say what to install: something is broken
        if os.environ.get("JAXLIGHT_TRACEBACK"):
            traceback.print_exc()
        return _complain(f"error: {_sentence(error)}", BAD_INPUT)


def _help(words: list[str]) -> int:
    """The help above all commands: their first lines and a first walk."""
    if words[0] == "--version":
        from jaxlight import __version__

        print(f"jaxlight {__version__}")
        return SUCCESS
    rows = [f"  {name:<11}{str(kind.__doc__).splitlines()[0]}" for name, kind in COMMANDS.items()]
    print(HELP.format(commands="\n".join(rows)))
    return SUCCESS


def _parse(words: list[str]) -> Any:
    """The command with its arguments. tyro explains mistakes in boxes; here they become one line."""
    if words and words[0] not in COMMANDS and not words[0].startswith("-"):
        raise ValueError(f"{words[0]!r:.60} is no command; expected one of {', '.join(COMMANDS)} (see jaxlight --help)")
    said = io.StringIO()
    try:
        with contextlib.redirect_stderr(said):
            return tyro.extras.subcommand_cli_from_dict(COMMANDS, prog="jaxlight", args=words)
    except SystemExit as stop:
        if stop.code in (0, None):
            raise
        command = next((word for word in words[:1] if word in COMMANDS), None)
        help_line = " ".join(filter(None, ["jaxlight", command, "--help"]))
        raise ValueError(f"{_condensed(said.getvalue())} (see {help_line})") from None


def _condensed(boxed: str) -> str:
    """What tyro's box says: its first section, and the first suggestion if there is one."""
    sections: list[list[str]] = [[]]
    for line in re.sub(r"\x1b\[[0-9;]*m", "", boxed).splitlines():
        if not line.startswith(("│ ", "  ")):  # the frame, or the title where the terminal has no line characters
            continue
        text = line[2:].rstrip(" │")
        if text.strip("─-") == "":
            sections.append([])
        elif len(text) - len(text.lstrip()) < 8:  # deeper lines repeat the help of an option
            sections[-1].append(text.strip())
    hints = [section[:2] for section in sections[1:] if section and section[0].startswith("Perhaps")]
    parts = [sections[0] or ["cannot read the arguments"], *hints[:1]]
    text = "; ".join(" ".join(part).removesuffix(".") for part in parts)
    for misread, expected in _MISREAD.items():
        text = re.sub(rf"Error parsing (\S+): {misread}", rf"\1: expected {expected}, got \2", text)
    return text


def _sentence(error: BaseException) -> str:
    """The error in one line."""
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename}: {error.strerror}" if error.filename else error.strerror
    return " ".join(str(error).split()) or type(error).__name__


def _complain(what: str, status: int) -> int:
    print(f"jaxlight: {what}", file=sys.stderr)
    return status


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"jaxlight: warning: {' '.join(str(message).split())}", file=sys.stderr)
