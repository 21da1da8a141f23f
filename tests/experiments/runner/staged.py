"""A task that takes a while in two stages, importable by workers."""

from __future__ import annotations

import time

from bayescal.inference.stages import count, stage


def take_a_while(pause: float, task: int) -> int:
    with stage("search"):
        time.sleep(pause)
    with stage("sampling", 10):
        for _ in range(10):
            time.sleep(0.1 * pause)
            count(1)
    return task**2
