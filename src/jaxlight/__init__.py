"""Differentiable VRML97 / X3D lighting for material and light fitting."""
