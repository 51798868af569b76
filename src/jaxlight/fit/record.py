"""What a run leaves on disk while it goes: a log line a step, and checkpoints to carry on from."""

from __future__ import annotations

import datetime
import importlib.metadata
import json
import math
import os
import platform
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from ..formats.limits import check_no_other
from .checkpoint import Checkpoint
from .problem import Description, Problem
from .run import FitState
from .steps import Step

_FIRST = b'{"event":'
"""What logs begin with."""
_PACKAGES = ("jaxlight", "jax", "optimistix", "equinox", "numpy")


class RunLog:
    """JSON lines: `begin` (what the run is), one `step` each, `resume` where it was carried on, `end` (how it ended).

    Each line is written at once, so that a killed process leaves whole lines; after a power cut the last may be torn,
    and is cut off when the run is resumed. Numbers that JSON has no word for (NaN, infinity) are null. Steps that were
    tried after the last checkpoint before a kill are there twice.

    Args:
        path: the file; its folder is made if it is not there.
        append: carry on with a log that is there.

    Raises:
        ValueError: another file is there, or something that is none.
    """

    def __init__(self, path: str | Path, *, append: bool = False) -> None:
        path = Path(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        check_no_other(path)
        if path.exists() and not _is_log(path):
            raise ValueError(f"log: {path} is no log of a fit, and is not replaced by one")
        if append and path.exists():
            os.truncate(path, path.read_bytes().rfind(b"\n") + 1)
        self._file = path.open("ab" if append else "wb", buffering=0)

    def write(self, event: str, **content: Any) -> None:
        """One line."""
        line = json.dumps({"event": event, **_plain(content)}, allow_nan=False, ensure_ascii=False)
        self._file.write(f"{line}\n".encode(errors="replace"))  # names of files need not be text

    def close(self) -> None:
        """No more lines."""
        self._file.close()


def _is_log(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(len(_FIRST)) in (b"", _FIRST)


class Record:
    """The log and the checkpoints of one run, either of which may be absent.

    Args:
        log: file of JSON lines, or None.
        checkpoint: where the run stands, or None.
        seconds: least time from one checkpoint to the next; 0: one after every step.
        resumed: the steps before this run, of a run that is carried on; None: it begins.
    """

    def __init__(
        self,
        log: str | Path | None,
        checkpoint: Checkpoint | None,
        *,
        seconds: float = 0.0,
        resumed: Sequence[Step] | None = None,
    ) -> None:
        self._log = None if log is None else RunLog(log, append=resumed is not None)
        self._checkpoint, self._seconds = checkpoint, seconds
        self._resumed = resumed
        self._saved_at, self._saved_steps = time.monotonic(), -1
        if checkpoint is not None:
            checkpoint.path.parent.mkdir(parents=True, exist_ok=True)

    def begin(self, problem: Problem, description: Description, state: FitState, max_steps: int) -> None:
        """Before the first step of this process."""
        if self._log is None:
            return
        if self._resumed is not None:
            after = self._resumed[-1].step if self._resumed else None
            self._write("resume", after_step=after, **_setting(), max_steps=max_steps)
            return
        parameters, few = problem.parameters, problem.parameters.few
        self._write(
            "begin",
            **_setting(),
            precision=str(parameters.start.dtype),
            scene=_counts(problem),
            views=[name or str(row) for row, name in enumerate(description.view_names)],
            residuals=description.residuals,
            loss=problem.loss_kind,
            max_steps=max_steps,
            free=description.labels,
            textures=[{"path": block.path, "shape": block.shape} for block in parameters.blocks],
            start=np.asarray(state.values)[:few],
            lower=np.asarray(parameters.lower)[:few],
            upper=np.asarray(parameters.upper)[:few],
        )

    def step(self, step: Step, state: FitState, history: Sequence[Step], few: int) -> None:
        """After every evaluation; `few` numbers at the front of the values are logged, texels are not."""
        self._write("step", **step._asdict(), values=np.asarray(state.values)[:few])
        if time.monotonic() - self._saved_at >= self._seconds:
            self.save(state, history)

    def save(self, state: FitState, history: Sequence[Step]) -> None:
        """A checkpoint, whatever the time."""
        if self._checkpoint is not None and len(history) != self._saved_steps:
            self._checkpoint.save(state, history)
            self._saved_at, self._saved_steps = time.monotonic(), len(history)

    def end(self, outcome: str, message: str, **content: Any) -> None:
        """How it ended; nothing can be recorded afterwards."""
        self._write("end", outcome=outcome, message=message, **content)
        if self._log is not None:
            self._log.close()
            self._log = None

    def fail(self, error: BaseException) -> None:
        """It ended by an error, or by an interrupt after which nothing is kept."""
        if isinstance(error, KeyboardInterrupt):
            self.end("interrupted", "Interrupted; nothing is kept.")
        else:
            self.end("error", f"{type(error).__name__}: {error}")

    def _write(self, event: str, **content: Any) -> None:
        if self._log is not None:
            self._log.write(event, **content)


def _setting() -> dict[str, Any]:
    """Where and by what a run was made."""
    versions = {name: importlib.metadata.version(name) for name in _PACKAGES}
    return {
        "time": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "versions": {**versions, "python": platform.python_version()},
        "device": jax.devices()[0].device_kind,
    }


def _counts(problem: Problem) -> dict[str, int]:
    """The scene in numbers."""
    scene = problem.world.scene
    rows = {
        "materials": scene.materials,
        "directional_lights": scene.directional,
        "point_lights": scene.point,
        "spot_lights": scene.spot,
    }
    return {
        **{kind: len(owner.names) for kind, owner in rows.items() if owner is not None},
        "textures": len(scene.textures),
    }


def _plain(value: Any) -> Any:
    """What JSON can carry."""
    if isinstance(value, dict):
        return {name: _plain(one) for name, one in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(one) for one in (value.tolist() if isinstance(value, np.ndarray) else value)]
    return None if isinstance(value, float) and not math.isfinite(value) else value
