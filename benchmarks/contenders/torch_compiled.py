"""PyTorch, `torch.compile`: the eager program, fused by Inductor."""

from __future__ import annotations

from collections.abc import Callable

import torch

from .torch_eager import TorchEager


class TorchCompiled(TorchEager):
    """Inductor on the eager functions; it compiles in the first call."""

    def forward_function(self) -> Callable[..., torch.Tensor]:
        return torch.compile(super().forward_function(), fullgraph=True, dynamic=False)

    def loss_function(self) -> Callable[..., torch.Tensor]:
        return torch.compile(super().loss_function(), fullgraph=True, dynamic=False)
