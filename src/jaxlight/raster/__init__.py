"""Triangles and a camera, or maps of a photograph, to a SampleBuffer: one row a visible surface point."""

from .camera import Camera as Camera
from .maps import Orthographic as Orthographic
from .maps import samples_from_maps as samples_from_maps
from .rasterize import rasterize as rasterize
from .samples import SampleBuffer as SampleBuffer
from .shapes import geometry_of as geometry_of
from .triangles import Triangles as Triangles
