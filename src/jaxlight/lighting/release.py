"""Releases of JAX that compute wrong images without a word are refused when the compiled path is imported."""

from __future__ import annotations

import jax

WRONG_RELEASES = ("0.10.2", "0.11.0", "0.11.1")


def refuse_wrong_release(version: str) -> None:
    """Raise ImportError, saying what to install, for a release of JAX that is known to compute wrong images."""
    if version in WRONG_RELEASES:
        raise ImportError(
            f"jax {version} computes wrong images on the CPU, silently; install another release: "
            f"pip install 'jax{',!='.join(['', *WRONG_RELEASES])[1:]}'"
        )


refuse_wrong_release(jax.__version__)
