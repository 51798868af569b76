"""Triangles and a camera to a SampleBuffer: one row a visible surface point, background left out."""

from .camera import Camera as Camera
from .rasterize import rasterize as rasterize
from .samples import SampleBuffer as SampleBuffer
from .tessellate import tessellate as tessellate
from .triangles import Triangles as Triangles
