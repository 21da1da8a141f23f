"""The command line: a module of commands each for running, machines, and results and projects."""

# The order of the imports is that of the help.
# isort: off
from bayescal.cli.app import OWN_FAULT, TRACEBACK, app, main
from bayescal.cli import run, machine, project

# isort: on

__all__ = ["OWN_FAULT", "TRACEBACK", "app", "machine", "main", "project", "run"]
