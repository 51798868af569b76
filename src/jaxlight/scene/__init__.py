"""X3D nodes as a person writes them, and the Scene pytree that the lighting equation reads."""

from . import nodes as nodes
from .scene import DirectionalLights as DirectionalLights
from .scene import Fog as Fog
from .scene import Materials as Materials
from .scene import PointLights as PointLights
from .scene import Scene as Scene
from .scene import SpotLights as SpotLights
from .scene import Surface as Surface
from .scene import Texture as Texture
