"""Fitting: free fields and pictures in, the fitted scene out, with what the pictures cannot tell."""

from .fitting import Fit as Fit
from .fitting import Step as Step
from .fitting import fit as fit
from .parameters import Free as Free
from .views import View as View
