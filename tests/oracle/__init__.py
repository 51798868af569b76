"""Independent oracles of the lighting equation: they import nothing of the package under test.

- `case`: the data that all of them take; `paths`: addresses of the numbers in it
- `equation`: plain NumPy float64, one sample at a time
- `exact`: 50 digits (mpmath), first and second derivatives, their bounds at kinks
- `condition`: condition numbers, and how far a case is from jumps and kinks, in ulp
- `fast_exact`: all of that for many cases at once, in 80-bit floats
- `cases`, `adversarial`: seeded random cases, and cases at every singular point (`families`)
"""

from .case import Case, Fog, Light, Material, Options, Sample

__all__ = ["Case", "Fog", "Light", "Material", "Options", "Sample"]
