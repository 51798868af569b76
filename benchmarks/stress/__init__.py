"""The lighting equation under stress: random and adversarial cases against the oracles of `tests/oracle`.

`python -m benchmarks.stress --help`, or `jaxlight stress` in a checkout.
"""

import sys
from pathlib import Path

# The oracles, and the bridge from their cases to scenes, are the tests' own.
sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests"))
