"""Where modules are looked for: nothing is imported from the folder that a command happens to be called in."""

from __future__ import annotations

import os
import sys


def list_elsewhere() -> list[str]:
    """Return `sys.path` without the current folder, from which nothing is imported unless bayescal itself lies there.

    Python puts it first for ``python -m`` and at a prompt: a stranger's file with a library's name would be run.
    """
    try:  # of os.path, which has been imported already: a library's name may be that of such a file
        here, own = os.path.realpath(os.curdir), os.path.realpath(f"{__file__}/../..")
    except OSError:  # a folder that is gone
        return sys.path[:]
    return [one for one in sys.path if here == own or os.path.realpath(one or os.curdir) != here]
