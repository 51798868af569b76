"""Materials of mesh formats -> X3D's Material: stated rules, and starting points for a fit rather than equivalents."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..scene.nodes import Material

MAX_EXPONENT = 128.0
"""X3D's shininess 1 (17.2.2.4)."""
_DIELECTRIC = 0.04
"""Reflectance of a dielectric seen straight on, as glTF assumes."""
_WHITE = (1.0, 1.0, 1.0, 1.0)
SPECULAR_GLOSSINESS = "KHR_materials_pbrSpecularGlossiness"
"""The glTF extension that describes a material by its diffuse and specular colour and its glossiness."""


def material_from_mtl(name: str, values: dict[str, Any], glossiness: float) -> Material:
    """The X3D material of an entry of an OBJ material library.

    diffuseColor = Kd, specularColor = Ks (0 where illum is 0 or 1), emissiveColor = Ke, shininess = Ns / 128,
    transparency = 1 - d (or Tr). ambientIntensity is the a for which a Kd comes closest to Ka; 0.2 without Ka.
    Everything is clipped to [0, 1]. Under a texture, MTL multiplies by Kd: that is `texture_mode="modulate"`.

    Args:
        name: the entry's name, which becomes the DEF name.
        values: its lines by lower-case key; values are numbers, or words for them, as `mtl_text` leaves them.
        glossiness: Ns.
    """
    diffuse = _color(values.get("kd"), (0.8, 0.8, 0.8))
    illumination = _number(values.get("illum"), 2.0)
    specular = _color(values.get("ks"), (0.0, 0.0, 0.0)) if illumination >= 2 else np.zeros(3)
    ambient_intensity = 0.2
    if values.get("ka") is not None and diffuse @ diffuse > 0:
        ambient_intensity = float(_color(values["ka"], (0.0, 0.0, 0.0)) @ diffuse / (diffuse @ diffuse))
    transparency = 1.0 - _number(values.get("d"), 1.0) if "d" in values else _number(values.get("tr"), 0.0)
    return _material(
        name,
        ambient_intensity=ambient_intensity,
        diffuse_color=diffuse,
        emissive_color=_color(values.get("ke"), (0.0, 0.0, 0.0)),
        shininess=glossiness / MAX_EXPONENT if "ns" in values else 0.2,
        specular_color=specular,
        transparency=transparency,
    )


class GltfFactors(NamedTuple):
    """The numbers of a glTF metallic-roughness or specular-glossiness material that X3D's Material is made of."""

    base: np.ndarray
    """Base colour and alpha [4]."""
    roughness: float
    straight_on: np.ndarray
    """F0 [3], the reflectance seen straight on."""
    scattering: float
    """How much of the base colour is scattered."""
    besides: np.ndarray
    """What is scattered whatever the base colour is [3]."""

    @classmethod
    def of(cls, description: dict[str, Any]) -> GltfFactors:
        """Those of a material of the glTF header."""
        glossy = description.get("extensions", {}).get(SPECULAR_GLOSSINESS)
        if glossy is not None:
            base = np.asarray(glossy.get("diffuseFactor", _WHITE), dtype=np.float64)
            roughness = 1.0 - float(np.clip(glossy.get("glossinessFactor", 1.0), 0.0, 1.0))
            straight_on = np.asarray(glossy.get("specularFactor", _WHITE[:3]), dtype=np.float64)
            return cls(base, roughness, straight_on, 1.0 - float(straight_on.max()), straight_on * roughness)
        factors = description.get("pbrMetallicRoughness", {})
        base = np.asarray(factors.get("baseColorFactor", _WHITE), dtype=np.float64)
        metallic = float(factors.get("metallicFactor", 1.0))
        roughness = float(np.clip(factors.get("roughnessFactor", 1.0), 0.0, 1.0))
        straight_on = _DIELECTRIC * (1.0 - metallic) + base[:3] * metallic
        return cls(base, roughness, straight_on, 1.0 - metallic * (1.0 - roughness), np.zeros(3))

    def diffuse(self, base: np.ndarray) -> np.ndarray:
        """diffuseColor [..., 3] of a base colour [..., 3]."""
        return base * self.scattering + self.besides


def material_from_gltf(name: str, description: dict[str, Any], *, see_through: bool) -> Material:
    """The X3D material of a glTF metallic-roughness or specular-glossiness material.

    With base colour b, metallic m, roughness r and F0 = 0.04 (1 - m) + b m, the exponent is n = 2 / r^4 - 2 in
    [0, 128] (the Blinn-Phong lobe as wide as the microfacets') and shininess = n / 128;
    specularColor = F0 (1 - r) (n + 8) / 8, the lobe's height; diffuseColor = b (1 - m (1 - r)): rough metal scatters.
    With KHR_materials_pbrSpecularGlossiness (diffuse d, specular f, glossiness g) the same lobe has F0 = f, r = 1 - g,
    and diffuseColor = d (1 - max(f)) + f r.
    emissiveColor = emissiveFactor. Everything is clipped to [0, 1]; the numbers stay linear, as they are in the file.

    Args:
        name: the DEF name.
        description: the material of the glTF header.
        see_through: alphaMode is not OPAQUE: transparency = 1 - alpha.
    """
    factors = GltfFactors.of(description)
    roughness = factors.roughness
    exponent = float(np.clip(2.0 / max(roughness, 1e-3) ** 4 - 2.0, 0.0, MAX_EXPONENT))
    return _material(
        name,
        ambient_intensity=0.2,
        diffuse_color=factors.diffuse(factors.base[:3]),
        emissive_color=np.asarray(description.get("emissiveFactor", (0.0, 0.0, 0.0)), dtype=np.float64),
        shininess=exponent / MAX_EXPONENT,
        specular_color=factors.straight_on * (1.0 - roughness) * (exponent + 8.0) / 8.0,
        transparency=1.0 - float(factors.base[3]) if see_through else 0.0,
    )


def unlit_material_from_gltf(name: str, description: dict[str, Any]) -> Material:
    """The X3D material of a glTF material that takes no light (KHR_materials_unlit): it only emits its base colour."""
    base = description.get("pbrMetallicRoughness", {}).get("baseColorFactor", _WHITE)
    emissive = np.asarray(base, dtype=np.float64)[:3]
    black = np.zeros(3)
    return _material(name, diffuse_color=black, emissive_color=emissive, specular_color=black)


def _material(name: str, **values: Any) -> Material:
    clipped: dict[str, Any] = {field: np.clip(value, 0.0, 1.0).tolist() for field, value in values.items()}
    return Material(name=name, **clipped)


def _number(value: Any, default: float) -> float:
    """The number of a line, as a word or as trimesh made one of it."""
    return default if value is None else float(np.ravel(value)[0])


def _color(value: Any, default: tuple[float, float, float]) -> np.ndarray:
    """The three numbers of a line, likewise."""
    return np.asarray(default if value is None else value, dtype=np.float64)
