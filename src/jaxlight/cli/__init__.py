"""The command line: `jaxlight info`, `render`, `fit`, `gradcheck`, and in a checkout `stress`."""

from .entry import main as main
