"""The command line: `jaxlight info`, `render`, `fit`, `gradcheck`, and in a checkout `stress`."""

from .app import main as main
