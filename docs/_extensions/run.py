"""Commands of tutorials, run while the pages are read: what is shown is what they print, and a failure ends the build.

A page's commands share an empty folder, ``_build/work/PAGE``; ``$ROOT`` is the repository. A ``{code-cell}`` holds
Python, as in a notebook. Options of a ``{run}`` block:

``exit``
    The exit code that is expected of the last command, 0 by default.
``lines``
    How many lines of output are shown at most.
``hidden``
    Run, and show nothing.
``page``
    A page that the commands have written: a link to it stands below them.

``sphinx-build -D run_commands=0`` shows the commands alone, to look over the text.
"""

from __future__ import annotations

import ast
import contextlib
import io
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx import addnodes
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective

if TYPE_CHECKING:
    from collections.abc import Callable

    from sphinx.application import Sphinx
    from sphinx.environment import BuildEnvironment

ROOT = Path(__file__).parents[2]
WORK = ROOT / "docs" / "_build" / "work"
TIME_LIMIT = 600.0  # s, of a command that hangs: two run beside each other, on whatever machine


def name_of(env: BuildEnvironment) -> str:
    """Return the name of the page that is read, without its folders."""
    return env.docname.rpartition("/")[2]


def enter(env: BuildEnvironment) -> Path:
    """Return the page's folder, emptied where this is the page's first block."""
    folder = WORK / name_of(env)
    if not env.temp_data.get("run_begun"):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        env.temp_data["run_begun"] = True
    return folder


class Run(SphinxDirective):
    """A block of commands with what they print."""

    has_content = True
    option_spec: ClassVar[dict[str, Callable[[str], object]]] = {
        "exit": directives.nonnegative_int,
        "lines": directives.positive_int,
        "hidden": directives.flag,
        "page": directives.unchanged_required,
    }

    def run(self) -> list[nodes.Node]:
        """Run the commands one by one; ExtensionError where one of them does not end as expected."""
        folder = enter(self.env)
        commands = _join("\n".join(self.content))
        shown = []
        for number, command in enumerate(commands, start=1):
            if not self.config.run_commands:
                shown.append(f"$ {command}")
                continue
            expected = self.options.get("exit", 0) if number == len(commands) else 0
            shown += [f"$ {command}", *_limit(self._call(command, folder, expected), self.options.get("lines"))]
        if "hidden" in self.options:
            return []
        text = "\n".join(line.rstrip() for line in shown)
        block = nodes.literal_block(text, text, language="text")  # outputs are no language
        return [block, *self._link()]

    def _link(self) -> list[nodes.Node]:
        """Return the link to a page that was written, where there is one."""
        if "page" not in self.options or not self.config.run_commands:
            return []
        target = f"/{WORK.relative_to(ROOT / 'docs').as_posix()}/{name_of(self.env)}/{self.options['page']}"
        words = nodes.Text("The page that this run has written")
        return [nodes.paragraph("", "", addnodes.download_reference("", "", words, reftarget=target), nodes.Text("."))]

    def _call(self, command: str, folder: Path, expected: int) -> list[str]:
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        environment = os.environ | {
            "ROOT": str(ROOT),
            "BAYESCAL_TRUST": "1",
            "PATH": path,
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }
        done = subprocess.run(
            ["bash", "-c", command],
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            timeout=TIME_LIMIT,
            check=False,
        )
        if done.returncode != expected:
            where = f"{self.env.docname}, line {self.lineno}"
            raise ExtensionError(
                f"{where}: {command!r} ended with {done.returncode}, expected {expected}:\n{done.stdout}"
            )
        return done.stdout.splitlines()


def _join(text: str) -> list[str]:
    """Return commands, those that go on in the next line (a backslash, or a text up to EOF) in one."""
    commands: list[str] = []
    going_on = False
    for line in text.splitlines():
        if going_on:
            commands[-1] += f"\n{line}"
        elif line.strip():
            commands.append(line)
        else:
            continue
        going_on = line.endswith("\\") or ("<<" in commands[-1] and line.strip() != "EOF")
    return commands


def _limit(lines: list[str], most: int | None) -> list[str]:
    return lines if most is None or len(lines) <= most else [*lines[:most], "..."]


class Cell(SphinxDirective):
    """A cell of a notebook: Python with what it prints and shows; a page's cells go on from one to the next."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        """Run the cell in the page's folder, as warnings being errors; ExtensionError where it fails."""
        code = "\n".join(self.content)
        found: list[nodes.Node] = [nodes.literal_block(code, code, language="python")]
        if not self.config.run_commands:
            return found
        names = self.env.temp_data.setdefault("cells", {"__name__": "__notebook__"})
        with contextlib.chdir(enter(self.env)), contextlib.redirect_stdout(io.StringIO()) as said:
            try:
                shown = run_cell(code, names)
            except Exception as error:
                raise ExtensionError(f"{self.env.docname}, line {self.lineno}: {error!r}") from error
        if text := said.getvalue() if shown is None or hasattr(shown, "_repr_html_") else f"{said.getvalue()}{shown!r}":
            found.append(nodes.literal_block(text, text, language="text"))
        if hasattr(shown, "_repr_html_"):
            found.append(nodes.raw("", shown._repr_html_(), format="html"))
        return found


def run_cell(code: str, names: dict[str, object]) -> object:
    """Run a cell; return the value of its last line, None where that is none."""
    tree = ast.parse(code)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, "<cell>", "exec"), names)
    return None if last is None else eval(compile(ast.Expression(last.value), "<cell>", "eval"), names)


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_config_value("run_commands", True, "env", types=[bool])
    app.add_directive("run", Run)
    app.add_directive("code-cell", Cell)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
