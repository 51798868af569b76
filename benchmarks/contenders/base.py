"""What every contender offers, so that one harness can check, time and weigh all of them."""

from __future__ import annotations

import abc
from collections.abc import Callable
from typing import Any, Literal, NamedTuple

import numpy as np

from ..workload import Arrays, Workload

Operation = Literal["forward", "value_and_gradient", "normal_equations", "fit"]
Run = Callable[[], Any]
"""Runs once and returns when the result is there."""


class ValueAndGradient(NamedTuple):
    """The sum of squared residuals and its derivative, by the names of `Arrays.parameters`."""

    value: float
    gradient: dict[str, np.ndarray]


class FitResult(NamedTuple):
    """Fitted fields by the names of `Arrays.parameters`, and how many steps (evaluations) it took."""

    values: dict[str, np.ndarray]
    steps: int


class Contender(abc.ABC):
    """A program that does one or more of the operations on a workload; it decodes the results of those it does."""

    views: int = 1
    """How many times it is given the workload's samples."""

    @abc.abstractmethod
    def __init__(self, work: Workload, arrays: Arrays) -> None:
        """Moves the arrays to where the program wants them."""

    @abc.abstractmethod
    def prepare(self, operation: Operation) -> Run:
        """The operation, compiled as far as the library can compile ahead of the first call."""

    def colors(self, result: Any) -> np.ndarray:
        """[3, N] of a forward result."""
        raise NotImplementedError

    def value_and_gradient(self, result: Any) -> ValueAndGradient:
        """Value and gradient in NumPy, of a result of that operation or of the normal equations."""
        raise NotImplementedError

    def fitted(self, result: Any) -> FitResult:
        """What a fit found."""
        raise NotImplementedError

    def release(self) -> None:  # noqa: B027  # to be overridden by those that have some
        """Gives cached memory back, so that a peak can be measured. Most have none."""


def split(parameters: dict[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Material fields and light fields of `Arrays.parameters`-like dictionaries."""
    groups: tuple[dict[str, Any], dict[str, Any]] = ({}, {})
    for name, value in parameters.items():
        group, field = name.split(".")
        groups[group == "lights"][field] = value
    return groups
