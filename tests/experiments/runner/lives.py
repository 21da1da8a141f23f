"""Tasks of which workers die, and that say which worker they met."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path


def end_life(marker: Path, task: str) -> str:
    """Kill the process that this runs in: the task ``always`` whenever it runs, ``once`` the first time."""
    if task == "always" or (task == "once" and not marker.exists()):
        marker.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return f"{task} done"


def say_pid(shared: None, task: int) -> int:
    time.sleep(0.02)
    return os.getpid()
