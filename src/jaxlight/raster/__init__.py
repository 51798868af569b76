"""Triangles and a camera to a SampleBuffer: one row a visible surface point, background left out."""

from .samples import SampleBuffer as SampleBuffer
