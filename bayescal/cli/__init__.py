"""The command line: a module of commands each for running, data, machines, results and projects."""

# The order of the imports is that of the help.
# isort: off
from bayescal.cli.app import app
from bayescal.cli import run, next_pose, table, data, machine, certificate, recheck, results, project
from bayescal.cli.main import OWN_FAULT, TRACEBACK, main

# isort: on

__all__ = [
    "OWN_FAULT",
    "TRACEBACK",
    "app",
    "certificate",
    "data",
    "machine",
    "main",
    "next_pose",
    "project",
    "recheck",
    "results",
    "run",
    "table",
]
