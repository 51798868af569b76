"""Releases of JAX that compute wrong images are refused, with a sentence that says what to install."""

from __future__ import annotations

import importlib

import jax
import pytest

from jaxlight.lighting import release


@pytest.mark.parametrize("version", ["0.10.2", "0.11.0", "0.11.1"])
def test_wrong_releases_are_refused_on_import(version: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(jax, "__version__", version)
    with pytest.raises(ImportError, match=f"jax {version} computes wrong images") as refusal:
        importlib.reload(release)
    assert "pip install 'jax!=0.10.2,!=0.11.0,!=0.11.1'" in str(refusal.value)


def test_the_installed_release_is_not_refused() -> None:
    importlib.reload(release)
    assert jax.__version__ not in release.WRONG_RELEASES


def test_the_package_refuses_to_install_beside_them() -> None:
    from importlib.metadata import requires

    (jax_requirement,) = [line for line in requires("jaxlight") or [] if line.startswith("jax") and "!=" in line]
    assert release.WRONG_RELEASES
    assert all(f"!={version}" in jax_requirement for version in release.WRONG_RELEASES)
