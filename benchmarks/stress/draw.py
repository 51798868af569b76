"""The cases of a run: blocks drawn from a seed, and one case found again by its label."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Literal

from oracle.adversarial import adversarial_cases
from oracle.case import Case
from oracle.cases import random_block

Kind = Literal["random", "adversarial"]
BLOCK = 4096


def blocks(seed: int, kind: Kind, count: int, shapes: int) -> Iterator[list[Case]]:
    """`count` cases of a kind, some thousand at a time, each labelled kind:block:name."""
    for block, start in enumerate(range(0, count, BLOCK)):
        yield _block(seed, kind, block, min(BLOCK, count - start), shapes)


def find(seed: int, label: str, shapes: int) -> Case:
    """The case that a run of this seed calls `label`.

    Raises:
        ValueError: there is none.
    """
    kind, _, rest = label.partition(":")
    block = rest.partition(":")[0]
    if kind in ("random", "adversarial") and block.isdigit():
        for case in _block(seed, kind, int(block), BLOCK, shapes):
            if case.label == label:
                return case
    raise ValueError(f"case: expected a label like random:0:17 or adversarial:0:fog_edge[3]-1, got {label!r}")


def family(case: Case) -> str:
    """What an adversarial case is about; "random" for the others."""
    kind, _, name = case.label.split(":")
    return kind if kind == "random" else name.partition("[")[0]


def features(case: Case) -> list[str]:
    """What a random case has, for the rows of the table."""
    sample, options = case.sample, case.options
    lit = case.material is not None and not case.line_or_point
    kinds = sorted({light.kind for light in case.lights if light.on}) if lit else ["unlit"]
    fog = [] if case.fog is None else [f"{case.fog.fog_type} fog"]
    frames = any(light.frame is not None for light in case.lights)
    others = {
        "frames": lit and frames,
        "texture": sample.texel is not None,
        "vertex colour": sample.color is not None,
        "specular gate": lit and options.specular_gate,
    }
    return [*kinds, *fog, *(name for name, there in others.items() if there)]


def _block(seed: int, kind: Kind, block: int, count: int, shapes: int) -> list[Case]:
    if kind == "random":
        return random_block(seed, block, count, shapes)
    drawn = adversarial_cases(seed * 1_000_003 + block, count)
    return [dataclasses.replace(case, label=f"adversarial:{block}:{case.label}") for case in drawn]
