"""Attributes that X3D 3.0 to 4.0 has and jaxlight does not read, by the elements that it does read."""

from __future__ import annotations

import functools

CHANGES_THE_PICTURE = {
    "Appearance": {"alphaCutoff", "alphaMode"},
    "Background": {
        "backUrl", "bottomUrl", "frontUrl", "groundAngle", "groundColor", "leftUrl", "rightUrl", "topUrl",
        "transparency",
    },
}  # fmt: skip
"""Those that other readers draw, by element."""

ON_EVERY_ELEMENT = frozenset({"DEF", "USE", "class", "containerField", "id", "style"})
"""What X3D lets any node have, and any USE."""
_OF_HTML = ("data-", "aria-", "on")
"""How other attributes of an element in a page start (`onclick`)."""
_ANYWHERE = frozenset({"bindTime", "description", "isActive", "isBound", "metadata"})
"""Of some nodes, or their events: not worth a word on any."""

_BOUNDED = {"bboxCenter", "bboxDisplay", "bboxSize", "visible"}
_IMAGE = {"autoRefresh", "autoRefreshTimeLimit", "load"}
_LIGHT = {"shadowIntensity", "shadows"}

_OWN = {
    "Anchor": {*_BOUNDED, "autoRefresh", "autoRefreshTimeLimit", "load", "parameter", "url"},
    "Billboard": {*_BOUNDED, "axisOfRotation"},
    "CADAssembly": {*_BOUNDED, "name"},
    "CADLayer": {*_BOUNDED, "name"},
    "Collision": {*_BOUNDED, "collide", "collideTime", "enabled"},
    "DirectionalLight": _LIGHT,
    "Group": _BOUNDED,
    "ImageTexture": _IMAGE,
    "LOD": {*_BOUNDED, "center", "forceTransitions", "range"},
    "Layer": {"isPickable", "objectType", "pickable", "visible"},
    "LayerSet": {"activeLayer", "order"},
    "Material": {
        "ambientTextureMapping", "diffuseTextureMapping", "emissiveTextureMapping", "normalScale",
        "normalTextureMapping", "occlusionStrength", "occlusionTextureMapping", "shininessTextureMapping",
        "specularTextureMapping",
    },
    "NavigationInfo": {
        "avatarSize", "speed", "transitionComplete", "transitionTime", "transitionType", "type", "visibilityLimit",
    },
    "PickableGroup": {*_BOUNDED, "objectType", "pickable"},
    "PointLight": _LIGHT,
    "Shape": {*_BOUNDED, "castShadow"},
    "SpotLight": _LIGHT,
    "StaticGroup": _BOUNDED,
    "Switch": _BOUNDED,
    "TextureCoordinate": {"mapping"},
    "TextureTransform": {"mapping"},
    "Transform": _BOUNDED,
    "Viewpoint": {
        "centerOfRotation", "farDistance", "jump", "nearDistance", "retainUserOffsets", "viewAll",
    },
    "ViewpointGroup": {*_BOUNDED, "center", "displayed", "retainUserOffsets", "size"},
}  # fmt: skip
"""By element. Fields that hold nodes are no attributes."""


def is_unread_field(tag: str, name: str) -> bool:
    """True for an attribute that an element of X3D may have though jaxlight does not read it.

    Args:
        tag: of an element that jaxlight reads.
        name: of an attribute, without a namespace. Names of events count: some browsers take them.
    """
    return name in _fields(tag) or is_of_html(name) or name.startswith("set_") or name.endswith("_changed")


def is_of_html(name: str) -> bool:
    """True for an attribute that scripts and style sheets of a page go by."""
    return len(name) > 2 and name.startswith(_OF_HTML)


@functools.cache
def _fields(tag: str) -> frozenset[str]:
    return ON_EVERY_ELEMENT | _ANYWHERE | _OWN.get(tag, set()) | CHANGES_THE_PICTURE.get(tag, set())
