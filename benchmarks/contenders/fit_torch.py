"""A fit with PyTorch: the eager renderer and `torch.optim.Adam`."""

from __future__ import annotations

from typing import Any

import torch

from ..fit_problem import fit_arrays, fit_start
from ..workload import Arrays, Workload
from .base import FitResult, Operation, Run
from .torch_eager import TorchEager, loss


class TorchFit(TorchEager):
    """Adam with a cosine schedule; values kept in the fields' ranges.

    Args:
        work, arrays: the workload; its target is replaced by its own picture.
        steps: of Adam.
    """

    def __init__(self, work: Workload, arrays: Arrays, steps: int = 1000) -> None:
        arrays = fit_arrays(work)
        super().__init__(work, arrays._replace(target=arrays.target.astype("float32")))
        self._start = {name: torch.from_numpy(value.copy()) for name, value in fit_start(arrays).items()}
        self._steps = steps

    def prepare(self, operation: Operation) -> Run:
        return self._fit

    def _fit(self) -> Any:
        free = {name: value.clone().requires_grad_() for name, value in self._start.items()}
        optimizer = torch.optim.Adam(list(free.values()), lr=0.03)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, self._steps)
        for _ in range(self._steps):
            optimizer.zero_grad()
            loss(self.shader, {**self._parameters, **free}, self._scene).backward()
            optimizer.step()
            schedule.step()
            with torch.no_grad():
                for name, value in free.items():
                    if name != "lights.location":
                        value.clamp_(1e-4, 1)
        return {name: value.detach() for name, value in free.items()}, self._steps

    def fitted(self, result: Any) -> FitResult:
        values, steps = result
        return FitResult({name: value.numpy() for name, value in values.items()}, steps)
