"""Independent oracles of the lighting equation: they import nothing of the package under test.

`equation`: NumPy float64, readable. `exact`: mpmath, derivatives and condition numbers. `fast_exact`: many cases at
once in 80-bit floats. `cases`: seeded random and adversarial cases. All take the dataclasses of `case`.
"""

from .case import Case, Fog, Light, Material, Options, Sample

__all__ = ["Case", "Fog", "Light", "Material", "Options", "Sample"]
