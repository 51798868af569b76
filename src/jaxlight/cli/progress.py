"""Progress on stderr: a bar where a person watches, silence where nobody does."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator


@contextlib.contextmanager
def stages(count: int) -> Iterator[Callable[[str], None]]:
    """A bar over `count` stages of unlike length; call what it yields with the name of the stage that begins."""
    from tqdm import tqdm

    with tqdm(total=count, disable=None, leave=False, bar_format="{desc} [{n}/{total}, {elapsed}]") as bar:
        begun = False

        def begin(name: str) -> None:
            nonlocal begun
            bar.update(1 if begun else 0)
            bar.set_description_str(name)
            begun = True

        yield begin
