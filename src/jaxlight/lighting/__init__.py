"""The lighting equation on sample buffers: pure, jitted, differentiable."""

from . import release as release
from .compiling import compiler_options as compiler_options
from .options import LightingOptions as LightingOptions
from .plan import Plan as Plan
from .plan import make_plan as make_plan
from .sample_sum import sum_over_samples as sum_over_samples
from .shade import shade as shade
from .shade import shade_planes as shade_planes
from .shade import shade_slots as shade_slots
from .shade import shade_tiles as shade_tiles
