"""`python -m benchmarks.stress`, the same as `jaxlight stress`."""

import sys

import tyro

from jaxlight.cli.stress import Stress

if __name__ == "__main__":
    sys.exit(tyro.cli(Stress).run())
