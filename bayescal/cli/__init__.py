"""The command line: a module of commands each for running, machines, and results and projects."""

import sys

from bayescal.search_path import list_elsewhere

# before libraries are imported, which a file of the current folder may be called as
sys.path[:] = list_elsewhere()

# The order of the imports is that of the help.
# isort: off
from bayescal.cli.app import OWN_FAULT, TRACEBACK, app, main  # noqa: E402
from bayescal.cli import run, machine, project  # noqa: E402

# isort: on

__all__ = ["OWN_FAULT", "TRACEBACK", "app", "machine", "main", "project", "run"]
