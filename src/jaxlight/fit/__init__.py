"""Fitting: free fields and pictures in, the fitted scene out, with what the pictures cannot tell."""

from .checkpoint import CheckpointWarning as CheckpointWarning
from .fitting import Fit as Fit
from .fitting import fit as fit
from .free import Free as Free
from .gradients import GradientCheck as GradientCheck
from .gradients import check_gradients as check_gradients
from .implicit import fitted_values as fitted_values
from .pictures import view_pictures as view_pictures
from .report import write_report as write_report
from .steps import Step as Step
from .views import View as View
