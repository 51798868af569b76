"""`python -m benchmarks.stress`."""

import sys

import tyro

from .command import Options, run

if __name__ == "__main__":
    sys.exit(run(tyro.cli(Options, description=__doc__)))
