"""Checkpoints: where a fit stands, in a file that is whole at every moment and that nobody has to trust.

One .npz file without pickled objects: a header (JSON), the steps so far, and every array of the `FitState` under its
path. Each checkpoint replaces the last one at once, and the one before stays beside it as `NAME.previous.npz`. Loading
checks format, problem, shapes and number types; a checkpoint of another problem is refused.
"""

from __future__ import annotations

import hashlib
import json
import warnings
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..formats.limits import check_no_other
from ..formats.safe_write import drafts_of, written_whole
from ..scene.flags import Flags
from .archive import array_in
from .earlier import LARGEST_HEADER, previous_of, spare_unfinished
from .problem import Problem
from .run import FitState, begin
from .solver import BoundedLevenbergMarquardt
from .steps import Step

FORMAT = 3
"""Changes whenever older checkpoints cannot be carried on with."""
MAX_STEPS = 1_000_000
"""Steps that a checkpoint may list."""
_SLACK = 1e-4
"""How far beyond bounds rounding brings numbers, at most, relative to themselves or 1."""


class CheckpointWarning(UserWarning):
    """A fit is resumed, but not as one would expect: from an older checkpoint, from none, or by another jax."""


class Saved(NamedTuple):
    """What a checkpoint holds."""

    state: FitState
    history: list[Step]


class _Damaged(ValueError):
    """A file that is no whole checkpoint; the one before may be."""


class Checkpoint:
    """The checkpoint file of one problem.

    Args:
        path: ends in .npz.
        problem, solver: what is fitted and how; with `run` they tell one run from another.
        run: more that a resumed run must have in common, such as the seed of random starts.

    Raises:
        ValueError: another suffix.
    """

    def __init__(self, path: str | Path, problem: Problem, solver: BoundedLevenbergMarquardt, run: Any = None) -> None:
        self.path = Path(path)
        if self.path.suffix != ".npz":
            raise ValueError(f"checkpoint: expected a name that ends in .npz, got {self.path}")
        self.previous = previous_of(self.path)
        self._digest = digest((problem, solver), run)
        template = eqx.filter_eval_shape(begin, problem, solver)
        leaves, self._structure = jax.tree_util.tree_flatten_with_path(template)
        self._bounds = [np.asarray(bound) for bound in (problem.parameters.lower, problem.parameters.upper)]
        self._leaves = {jax.tree_util.keystr(path): leaf for path, leaf in leaves}

    def save(self, state: FitState, history: Sequence[Step]) -> None:
        """Make this state the checkpoint; a reader finds the old one or the new one, whatever happens meanwhile."""
        header = {"format": FORMAT, "problem": self._digest, "jax": jax.__version__}
        arrays = dict(zip(self._leaves, map(np.asarray, jax.tree.leaves(state)), strict=True))
        arrays["history"] = np.array(history, np.float64).reshape(len(history), len(Step._fields))
        arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
        with written_whole(self.path) as draft:
            with draft.open("wb") as file:
                np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]
            if self.path.exists():
                self.path.replace(self.previous)

    def load(self) -> Saved | None:
        """The newest whole checkpoint; None if there is none.

        Raises:
            ValueError: it is no file, belongs to another problem or another version, or all there is is damaged.
        """
        for draft in drafts_of(self.path):
            draft.unlink()  # a run was killed while it wrote
        there = [path for path in (self.path, self.previous) if path.exists()]
        damages = []
        for path in there:
            check_no_other(path)
            try:
                saved = self._read(path)
            except _Damaged as damage:
                damages.append(str(damage))
                continue
            if damages:
                said = f"{damages[0]}; resuming from the one before it, {path.name}"
                warnings.warn(said, CheckpointWarning, stacklevel=2)
            return saved
        if damages:
            raise ValueError(f"{'; '.join(damages)}; remove what is damaged to begin anew")
        return None

    def spare_earlier(self) -> None:
        """Raise ValueError if what is there would be lost: anything but this fit, over."""
        spare_unfinished(self.path, self.previous, fit=self._digest)

    def _read(self, path: Path) -> Saved:
        try:
            with zipfile.ZipFile(path) as file:
                header = self._header(path, array_in(file, "header", LARGEST_HEADER))
                history = array_in(file, "history", 8 * len(Step._fields) * MAX_STEPS)
                arrays = [
                    self._checked(name, array_in(file, name, leaf.size * leaf.dtype.itemsize), leaf)
                    for name, leaf in self._leaves.items()
                ]
            if history.dtype != np.float64 or history.ndim != 2 or history.shape[1] != len(Step._fields):
                raise ValueError(f"history: expected float64 [steps, {len(Step._fields)}]")
            steps = [_as_step(row) for row in history.tolist()]
            self._check_numbers(dict(zip(self._leaves, arrays, strict=True)))
        except _Refused:
            raise
        except Exception as error:  # archive, array and JSON readers stumble over a damaged file in whatever way
            raise _Damaged(f"{path}: not a whole checkpoint ({_reason(error)})") from None
        if header["jax"] != jax.__version__:
            said = f"{path}: written with jax {header['jax']}; with {jax.__version__} the last digits may differ"
            warnings.warn(said, CheckpointWarning, stacklevel=3)
        return Saved(jax.tree.unflatten(self._structure, [jnp.asarray(array) for array in arrays]), steps)

    def _header(self, path: Path, array: np.ndarray) -> dict[str, str]:
        header = json.loads(array.tobytes())
        if not isinstance(header, dict) or not isinstance(header.get("jax"), str):
            raise ValueError("its header is none")
        if header.get("format") != FORMAT:
            raise _Refused(f"{path}: checkpoint of format {header.get('format')!r:.20}; this version reads {FORMAT}")
        if header.get("problem") != self._digest:
            raise _Refused(
                f"{path}: belongs to another fit: scene, views, free fields, precision and options must be those with "
                "which it was written; overwrite=True (--overwrite) begins anew"
            )
        return header

    def _checked(self, name: str, array: np.ndarray, leaf: Any) -> np.ndarray:
        if array.shape != leaf.shape or array.dtype != leaf.dtype:
            came = f"{array.dtype} {list(array.shape)}"
            raise ValueError(f"{name}: expected {leaf.dtype} {list(leaf.shape)}, got {came}")
        return array

    def _check_numbers(self, arrays: dict[str, np.ndarray]) -> None:
        """Raise ValueError for what no fit reaches: it would be carried on with."""
        lower, upper = self._bounds
        for name in (".values", ".origin"):
            values = arrays[name]
            slack = _SLACK * np.maximum(1, np.abs(values))
            if not np.all(np.isfinite(values) & (values >= lower - slack) & (values <= upper + slack)):
                raise ValueError(f"{name}: expected finite numbers within the bounds of the fit")
        loss = arrays[".solver.loss"]
        if not arrays[".over"] and not (np.isfinite(loss) and loss >= 0):
            raise ValueError(f".solver.loss: expected a finite number >= 0, got {loss}")


class _Refused(ValueError):
    """A whole checkpoint, but none of this fit."""


def digest(tree: Any, more: Any = None) -> str:
    """SHA-256 of everything in a pytree, numbers and static parts, and of the `repr` of `more`."""
    leaves, structure = jax.tree.flatten(tree)
    content = hashlib.sha256(repr(more).encode())
    for part in (*leaves, *_static_parts(structure)):
        if isinstance(part, Flags):  # its repr is shortened
            part = part.array
        if eqx.is_array_like(part):
            array = np.asarray(part)
            content.update(f"{array.dtype} {array.shape} ".encode())
            content.update(array.tobytes())
        else:
            # A function's repr has an address, which is another one tomorrow.
            content.update((getattr(part, "__qualname__", None) or repr(part)).encode())
    return content.hexdigest()


def _static_parts(structure: Any) -> Iterator[Any]:
    data = structure.node_data()
    if data is not None:
        yield from _flattened(data)
    for child in structure.children():
        yield from _static_parts(child)


def _flattened(part: Any) -> Iterator[Any]:
    if type(part) in (tuple, list):
        yield len(part)
        for one in part:
            yield from _flattened(one)
    else:
        yield part


def _as_step(row: list[float]) -> Step:
    step = Step(*row)  # pyright: ignore[reportArgumentType]
    return step._replace(step=int(step.step), accepted=bool(step.accepted))


def _reason(error: BaseException) -> str:
    if isinstance(error, KeyError):
        return f"{error.args[0]}"
    return " ".join(str(error).split())[:120] or type(error).__name__
