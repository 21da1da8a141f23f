"""What a class's file imports from beside itself belongs to it: found, hashed, taken again when changed, sent on."""

import subprocess
import sys

import cloudpickle
import pytest

from bayescal.config.local_imports import find_local_imports
from bayescal.config.registry import hash_modules, list_sources, load_class

OWN = """
import numpy as np
import helper
from inner import far
from inner.near import slope

from bayescal import Channel, Coordinate, ParameterBlock, ReadingMachine


class Own(ReadingMachine):
    def __init__(self, config):
        self.parameters = [ParameterBlock("l", (helper.LENGTH,))]
        self.coordinates = [Coordinate("x", "mm")]
        self.channels = [Channel("s", "mm")]

    def read(self, parameters, v, given):
        return helper.scale(v) * slope() + far.BEYOND


def use(machine=Own):
    return machine(None).read({}, 2.0, {}), machine(None).parameters[0].nominal
"""
FILES = {
    "own.py": OWN,
    "helper.py": "import deeper\nLENGTH = 3.0\n\ndef scale(v):\n    return deeper.FACTOR * v\n",
    "deeper.py": "FACTOR = 5.0\n",
    "inner/__init__.py": "",
    "inner/near.py": "from . import far\nfrom .far import BEYOND\n\ndef slope():\n    return 1.0 + 0.0 * BEYOND\n",
    "inner/far.py": "BEYOND = 7.0\n",
    "unused.py": "raise RuntimeError\n",
}
LOCAL = {"helper.py", "deeper.py", "inner/__init__.py", "inner/near.py", "inner/far.py"}


@pytest.fixture
def folder(tmp_path):
    for name, text in FILES.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def read_with(folder):
    found = load_class("MACHINES", "own.py:Own", folder)
    return found(None).read({}, 2.0, {})


def test_everything_that_is_imported_from_beside_is_listed(folder):
    assert list_sources("MACHINES", "own.py:Own", folder)[0] == "own.py"
    assert set(list_sources("MACHINES", "own.py:Own", folder)[1:]) == LOCAL
    assert list_sources("MACHINES", "own:Own", folder) == []


def test_files_of_other_folders_do_not_count(folder):
    (folder / "deep").mkdir()
    (folder / "own.py").rename(folder / "deep" / "own.py")
    (folder / "deep" / "helper.py").symlink_to(folder / "helper.py")
    assert find_local_imports(folder / "deep" / "own.py") == {}
    (folder / "deep" / "helper.py").unlink()
    (folder / "deep" / "helper.py").write_text("")
    assert set(find_local_imports(folder / "deep" / "own.py")) == {"helper"}


def test_a_class_of_a_folder_below_brings_what_it_imports(folder):
    names = {f"{folder.name}/{one}" for one in LOCAL | {"own.py"}}
    assert set(list_sources("MACHINES", f"{folder.name}/own.py:Own", folder.parent)) == names
    assert load_class("MACHINES", f"{folder.name}/own.py:Own", folder.parent)(None).read({}, 2.0, {}) == 17.0


def test_installed_modules_go_first(folder):
    (folder / "numpy.py").write_text("")
    (folder / "json.py").write_text("")
    (folder / "own.py").write_text("import json\nimport numpy\n")
    assert find_local_imports(folder / "own.py") == {}


def test_a_mere_folder_of_the_same_name_is_no_installed_module(folder, tmp_path_factory, monkeypatch):
    other = tmp_path_factory.mktemp("other")
    (other / "helper").mkdir()
    monkeypatch.syspath_prepend(other)
    assert "helper.py" in list_sources("MACHINES", "own.py:Own", folder)
    assert read_with(folder) == 17.0


def test_a_file_that_is_no_python_is_left_to_its_import(folder):
    (folder / "own.py").write_text("import helper\nclass:\n")
    assert find_local_imports(folder / "own.py") == {}


def test_a_changed_import_is_another_class(folder):
    before = load_class("MACHINES", "own.py:Own", folder)
    assert read_with(folder) == 17.0
    assert load_class("MACHINES", "own.py:Own", folder) is before
    (folder / "deeper.py").write_text("FACTOR = 50.0\n")
    assert read_with(folder) == 107.0
    assert before(None).read({}, 2.0, {}) == 17.0


def test_files_of_one_name_in_two_folders_stay_apart(folder, tmp_path_factory):
    other = tmp_path_factory.mktemp("other")
    for name, text in FILES.items():
        (other / name).parent.mkdir(exist_ok=True)
        (other / name).write_text(text.replace("BEYOND = 7.0", "BEYOND = 70.0"))
    assert (read_with(folder), read_with(other), read_with(folder)) == (17.0, 80.0, 17.0)


def test_another_process_is_sent_the_whole(folder, tmp_path_factory):
    found = load_class("MACHINES", "own.py:Own", folder)
    use = sys.modules[found.__module__].use
    kept = tmp_path_factory.mktemp("kept") / "use.pkl"
    kept.write_bytes(cloudpickle.dumps((use, found)))
    script = "import pickle, sys; use, found = pickle.load(open(sys.argv[1], 'rb')); print(use(found))"
    done = subprocess.run([sys.executable, "-c", script, kept], capture_output=True, text=True, cwd=kept.parent)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["(17.0,", "(3.0,))"]


SCHEMA = """
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from bayescal.config.sections import Section


class One(Section):
    of: Literal["one"]
    count: int

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.count == 3:
            raise ValueError("three")
        return self


class Two(Section):
    of: Literal["two"]


type Either = Annotated[One | Two, Field(discriminator="of")]
"""
WITH_SCHEMA = """
from schema_beside import Either

from bayescal.config.sections import Section


class Whole(Section):
    study: Either


class Own(Own):
    Config = Whole
"""


def test_another_process_is_sent_a_schema_that_checks(folder, tmp_path_factory):
    """Of sections within sections, chosen by a key, with a check of their own: pydantic's parts refer to each other."""
    (folder / "schema_beside.py").write_text(SCHEMA)
    (folder / "own.py").write_text(OWN + WITH_SCHEMA)
    schema = load_class("MACHINES", "own.py:Own", folder).Config
    kept = tmp_path_factory.mktemp("kept") / "schema.pkl"
    kept.write_bytes(cloudpickle.dumps(schema.model_validate({"study": {"of": "one", "count": 2}})))
    script = "import pickle, sys; found = pickle.load(open(sys.argv[1], 'rb')); print(found.study.count); "
    script += "print(type(found).model_validate({'study': {'of': 'two'}}).model_dump()); "
    script += "type(found).model_validate({'study': {'of': 'one', 'count': 3}})"
    done = subprocess.run([sys.executable, "-c", script, kept], capture_output=True, text=True, cwd=kept.parent)
    assert done.stdout == "2\n{'study': {'of': 'two'}}\n"
    assert "ValidationError" in done.stderr
    assert ", three" in done.stderr


def test_files_beside_are_no_installed_modules(folder):
    (folder / "own.py").write_text("from base import Base\n\n\nclass Own(Base):\n    pass\n")
    (folder / "base.py").write_text(OWN.replace("class Own", "class Base").replace("machine=Own", "machine=None"))
    found = load_class("MACHINES", "own.py:Own", folder)
    assert "base.py" in list_sources("MACHINES", "own.py:Own", folder)
    assert hash_modules([found]) == {}


def test_nothing_is_left_beside_the_file(folder, monkeypatch):
    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    before = sorted(folder.rglob("*"))
    load_class("MACHINES", "own.py:Own", folder)
    assert sorted(folder.rglob("*")) == before
    assert not sys.dont_write_bytecode
