"""Samples to pictures: resolve, encode, compare."""

from .background import sky as sky
from .compare import Difference as Difference
from .compare import compare as compare
from .encode import decode as decode
from .encode import encode as encode
from .encode import linear_to_srgb as linear_to_srgb
from .encode import srgb_to_linear as srgb_to_linear
from .pixels import render as render
from .pixels import resolve as resolve
