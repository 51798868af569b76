"""The command line: `jaxlight info`, `render`, `fit`, `gradcheck`."""

from .app import main as main
