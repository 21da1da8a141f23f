"""Papers' experiments stand beside the package and use it as anybody does: by public names, and not by each other's."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import studies

FILES = sorted(studies.EXPERIMENTS.rglob("*.py"))
INSTALLED = ("matplotlib", "numpy", "pandas", "pydantic", "scipy")


def list_imports(path: Path) -> Iterator[tuple[str, str]]:
    """Yield modules and names that a file imports."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from ((one.name, "") for one in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from ((node.module or "", one.name) for one in node.names)


def test_papers_are_here():
    assert {path.parent.name for path in FILES} == {"pose_selection", "rr8096", "sika2008", "telescope", "yu2023"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(studies.EXPERIMENTS)))
def test_a_paper_imports_public_names_and_its_own(path):
    paper = studies.EXPERIMENTS / path.relative_to(studies.EXPERIMENTS).parts[0]
    own = {one.stem for one in paper.iterdir()}
    for module, name in list_imports(path):
        assert module.partition(".")[0] in (*sys.stdlib_module_names, *INSTALLED, "bayescal", *own), module
        assert not any(part.startswith("_") for part in (*module.split("."), name) if part != "__future__"), name


@pytest.mark.parametrize("name", ["figures", "pages"])
@pytest.mark.parametrize("paper", ["sika2008", "yu2023"])
def test_pages_know_results_and_not_what_they_were_computed_with(paper, name):
    own = {module for module, _ in list_imports(studies.EXPERIMENTS / paper / paper / f"{name}.py")}
    assert all(module.startswith("bayescal.report") for module in own if module.startswith("bayescal"))
    assert {module for module in own if module.startswith(paper)} <= {paper, f"{paper}.figures"}
