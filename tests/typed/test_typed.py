"""What type checkers and editors know of the public names: a user's script passes the strictest check."""

import ast
import inspect
import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import bayescal
from bayescal import extend

HERE = Path(__file__).parent


def test_type_checkers_see_the_names_that_python_sees():
    tree = ast.parse(inspect.getsource(bayescal))
    (block,) = (node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING")
    seen = {one.asname: node.module for node in block.body for one in node.names}
    assert seen == bayescal._HOMES


@pytest.mark.runs
def test_a_user_s_script_passes_mypy_strict(tmp_path):
    options = [
        "--strict",
        "--follow-imports=silent",
        f"--cache-dir={tmp_path}",
        f"--config-file={tmp_path / 'none.ini'}",
    ]
    (tmp_path / "none.ini").write_text("[mypy]\n")
    command = [sys.executable, "-m", "mypy", *options, HERE / "script.py"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=HERE.parents[1])
    assert done.returncode == 0, done.stdout


@pytest.mark.runs
def test_a_user_s_script_passes_pyright_beside_the_package_as_installed(tmp_path):
    pytest.importorskip("basedpyright", reason="make check installs it")
    package, left_out = HERE.parents[1] / "bayescal", shutil.ignore_patterns("__pycache__")
    shutil.copytree(package, tmp_path / "site" / "bayescal", ignore=left_out)
    shutil.copy(HERE / "script.py", tmp_path)
    options = {"typeCheckingMode": "standard", "include": ["script.py"], "extraPaths": ["site"]}
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(options))
    command = [sys.executable, "-m", "basedpyright", "--pythonpath", sys.executable]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stdout


def test_the_script_names_all_that_is_public():
    text = (HERE / "script.py").read_text()
    assert [name for name in bayescal.__all__ if f"bc.{name}" not in text] == []
    assert [name for name in extend.__all__ if f"bx.{name}" not in text and f"bc.{name}" not in text] == []
