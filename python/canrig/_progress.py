"""Progress of a run, in a notebook or on a terminal."""

from __future__ import annotations

import sys
from typing import Any, Callable, Optional, Union

#: Takes the part that is done, from 0 to 1, and what there is to say of it.
Progress = Union[None, bool, Callable[[float, str], None]]


def printer(progress: Progress) -> Optional[Callable[[float, str], None]]:
    """The function that is called with the progress; ``None`` shows a line in notebooks and on terminals only."""
    if callable(progress):
        return progress
    is_shown = _is_seen() if progress is None else progress
    return _Line() if is_shown else None


def _is_seen() -> bool:
    shell: Any = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    if type(shell).__name__ == "ZMQInteractiveShell":
        return True
    return sys.stderr is not None and sys.stderr.isatty()


class _Line:
    """One line that is written again and again, and is empty at the end."""

    def __init__(self) -> None:
        self._percent = -1

    def __call__(self, part: float, text: str) -> None:
        percent = int(100 * part)
        if percent == self._percent:
            return
        self._percent = percent
        filled = percent // 5
        line = f"{'█' * filled}{'░' * (20 - filled)} {percent:3} %  {text}" if part < 1 else ""
        sys.stderr.write(f"\r{line:<60}" + ("\r" if part >= 1 else ""))
        sys.stderr.flush()
