"""Results are replaced whole or not at all; finished tasks survive a kill, damaged ones count as not finished."""

from __future__ import annotations

import contextlib
import io
import json
import os
import pickle
import random
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from refusals import line_of
from studies import snapshot, write_texts

from bayescal.errors import InputError
from bayescal.experiments.runner import store as store_module
from bayescal.experiments.runner.identity import hash_identity
from bayescal.experiments.runner.store import IDENTITY_FILE, PROVENANCE_FILE, Store, list_differences
from bayescal.files.atomic import read_json, write_atomically
from bayescal.files.manifest import check_whole, write_manifest

IDENTITY = {"config": {"seed": 1, "sampler": {"steps": 10}, "free": ["a", "b"]}, "files": {"data.csv": "abc"}}
ARRAYS = {"draws": np.arange(600.0).reshape(20, 30), "wall_seconds": np.array(0.5)}


class KilledError(BaseException):
    """Stands for the moment at which a process is killed."""


@pytest.fixture
def store(tmp_path) -> Store:
    """Return a store that has begun."""
    found = Store(tmp_path / "results" / "study")
    found.begin(IDENTITY, resume=False)
    return found


def fill(folder: Path, content: str) -> None:
    """Put the results of one run in a folder."""
    provenance = {"config_sha256": hash_identity(IDENTITY), **IDENTITY}
    (folder / PROVENANCE_FILE).write_text(json.dumps(provenance))
    (folder / "tables").mkdir()
    for name in ("summary.json", "tables/variants.csv"):
        (folder / name).write_text(content)


def contents(folder: Path) -> set[str]:
    return {(folder / name).read_text() for name in ("summary.json", "tables/variants.csv")}


def list_names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def publish(store: Store, content: str) -> None:
    fill(store.stage(), content)
    store.publish()


# --- publishing ------------------------------------------------------------------------------------------------------


def test_publish_replaces_everything_and_removes_the_work(store):
    publish(store, "old")
    (store.out / "left over").touch()
    store.begin(IDENTITY, resume=False)
    store.save_task("k", ARRAYS)
    publish(store, "new")
    assert contents(store.out) == {"new"}
    assert not (store.out / "left over").exists()
    assert list_names(store.out.parent) == ["study"]


@pytest.mark.parametrize("step", ["stage", "rename", "exchange", "remove staged", "remove partial"])
@pytest.mark.parametrize("exists", [False, True], ids=["first", "again"])
def test_kill_leaves_the_old_results_or_the_new(store, monkeypatch, step, exists):
    if exists:
        publish(store, "old")
        store.begin(IDENTITY, resume=False)
    fill(store.stage(), "new")
    done = []

    def kill(*arguments, **options):
        raise KilledError

    def kill_second_time(path, **options):
        if done:
            raise KilledError
        done.append(path)

    with monkeypatch.context() as patched:
        if step == "stage":
            (store.staged / "tables" / "variants.csv").unlink()  # killed while writing: nothing is published
        elif step == "rename":
            patched.setattr(Path, "rename", kill)
            patched.setattr(store_module, "_exchange", kill)
        elif step == "exchange":
            patched.setattr(store_module.shutil, "rmtree", kill)
        else:
            patched.setattr(store_module.shutil, "rmtree", kill if step == "remove staged" else kill_second_time)
        if step != "stage":
            with contextlib.suppress(KilledError):
                store.publish()
    if store.out.exists():
        assert contents(store.out) in ({"old"}, {"new"})
        assert contents(store.out) == ({"old"} if step in ("stage", "rename") else {"new"})
    else:
        assert not exists
        assert step in ("stage", "rename")
    store.check_results(IDENTITY)
    store.begin(IDENTITY, resume=False)
    publish(store, "next")
    assert contents(store.out) == {"next"}
    assert list_names(store.out.parent) == ["study"]


@pytest.mark.parametrize("at_once", [True, False])
def test_exchange_is_one_system_call_where_there_is_one(store, monkeypatch, at_once):
    publish(store, "old")
    store.begin(IDENTITY, resume=False)
    fill(store.stage(), "new")
    if at_once:
        monkeypatch.setattr(Path, "rename", None)  # a second step would be needed without the system call
    else:
        monkeypatch.setattr(store_module.ctypes, "CDLL", lambda *_, **__: None)
    store.publish()
    assert contents(store.out) == {"new"}
    assert list_names(store.out.parent) == ["study"]


def test_results_behind_a_link_are_replaced_where_they_are(store):
    publish(store, "old")
    link = store.out.parent.parent / "link"
    link.symlink_to(store.out)
    linked = Store(link)
    linked.begin(IDENTITY, resume=False)
    publish(linked, "new")
    assert link.is_symlink()
    assert contents(store.out) == {"new"}


def test_current_directory_may_hold_the_results(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    store = Store(Path())
    store.check_results(IDENTITY)
    store.begin(IDENTITY, resume=False)
    publish(store, "new")
    assert contents(tmp_path / "here") == {"new"}


def test_write_atomically_leaves_the_old_file_when_killed(tmp_path, monkeypatch):
    path = tmp_path / "file"
    write_atomically(path, b"old")

    def kill(*_):
        raise KilledError

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", kill)
        with pytest.raises(KilledError):
            write_atomically(path, b"new")
    assert path.read_bytes() == b"old"
    write_atomically(path, b"new")
    assert snapshot(tmp_path) == {"file": b"new"}


def test_write_atomically_to_a_directory(tmp_path):
    with pytest.raises(InputError, match="is a directory"):
        write_atomically(tmp_path, b"text")


# --- refusals --------------------------------------------------------------------------------------------------------


def test_new_and_empty_directories_and_own_results_are_fine(store):
    store.check_results(IDENTITY)
    store.out.mkdir()
    store.check_results(IDENTITY)
    publish(store, "old")
    store.check_results(IDENTITY)


def put(name: str, text: str) -> Callable[[Store], None]:
    """Return what puts a file instead of results, or into a directory there."""
    return lambda store: write_texts(store.out.parent, {f"study{name}": text})


REFUSED = {
    "of another seed": (lambda store: publish(store, "old"), "another config .*, expected"),
    "a directory": (put("/thesis.tex", "years"), "holds no results, expected a new or a results directory"),
    "a file": (put("", "precious"), "holds no results, expected a new or a results directory"),
    **{
        f"provenance {text!r}": (put(f"/{PROVENANCE_FILE}", text), r"provenance\.json")
        for text in ("", "{", "[1]", '"x"', "\x00")
    },
}


@pytest.mark.parametrize("there", REFUSED)
def test_what_stands_there_is_not_replaced(store, there):
    put_there, said = REFUSED[there]
    put_there(store)
    before = snapshot(store.out.parent)
    assert re.search(said, line_of(store.check_results, {**IDENTITY, "config": IDENTITY["config"] | {"seed": 2}}))
    assert snapshot(store.out.parent) == before


def test_a_foreign_directory_in_the_way_of_the_work_is_not_emptied(tmp_path):
    store = Store(tmp_path / "study")
    store.partial.mkdir()
    (store.partial / "thesis.tex").write_text("precious")
    before = snapshot(tmp_path)
    with pytest.raises(InputError, match=r"study\.partial:"):
        store.begin(IDENTITY, resume=False)
    assert snapshot(tmp_path) == before


def test_begin_again_forgets_the_interrupted_run(store):
    store.save_task("k", ARRAYS)
    (store.partial / "k2.npz.tmp").write_bytes(b"half")
    store.begin(IDENTITY, resume=False)
    assert list_names(store.partial) == [IDENTITY_FILE]


# --- resuming --------------------------------------------------------------------------------------------------------


def test_resume_keeps_the_tasks(store):
    store.save_task("k", ARRAYS)
    store.begin(IDENTITY, resume=True)
    found = store.load_task("k")
    assert found is not None
    assert found.keys() == ARRAYS.keys()
    for name, values in ARRAYS.items():
        np.testing.assert_array_equal(found[name], values)
        assert found[name].dtype == values.dtype


def test_resume_with_another_config_lists_every_difference(store):
    other = json.loads(json.dumps(IDENTITY))
    other["config"]["sampler"]["steps"] = 20
    other["config"]["free"] = ["a", "c"]
    other["files"]["data.csv"] = "def"
    other["config"]["new"] = 1
    before = snapshot(store.out.parent)
    with pytest.raises(InputError) as caught:
        store.begin(other, resume=True)
    message = str(caught.value)
    assert "\n" not in message
    for difference in (
        "config.sampler.steps: 10 -> 20",
        'config.free[1]: "b" -> "c"',
        'files.data.csv: "abc" -> "def"',
        "config.new: null -> 1",
    ):
        assert difference in message
    assert "seed" not in message
    assert snapshot(store.out.parent) == before


def test_no_differences_between_equals():
    assert list_differences(IDENTITY, json.loads(json.dumps(IDENTITY))) == []
    assert list_differences({"a": [1, 2]}, {"a": [1, 2, 3]}) == ["a: [1, 2] -> [1, 2, 3]"]
    assert list_differences({"a": 1}, {"a": {"b": 1}}) == ['a: 1 -> {"b": 1}']


# --- tasks -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(3))
def test_damaged_task_counts_as_not_finished(store, seed):
    assert store.load_task("k") is None
    store.save_task("k", ARRAYS)
    path, bare = store.partial / "k.npz", io.BytesIO()
    np.save(bare, np.zeros(3))
    whole, rng = path.read_bytes(), random.Random(seed)
    damaged = [b"", b"PK", b"\x93NUMPY", bare.getvalue(), whole[: len(whole) // 2], whole[:-1], whole[1:]]
    damaged += [whole[: rng.randrange(len(whole))] for _ in range(30)]
    for _ in range(60):
        at = rng.randrange(300, 4000)  # in the numbers of the first array
        damaged.append(whole[:at] + bytes([whole[at] ^ (1 << rng.randrange(8))]) + whole[at + 1 :])
    for content in damaged:
        path.write_bytes(content)
        assert store.load_task("k") is None


class Bomb:
    """Does something on being unpickled."""

    exploded = False

    def __reduce__(self):
        return (setattr, (Bomb, "exploded", True))


def test_nothing_is_pickled_or_unpickled(store):
    with pytest.raises(ValueError, match="Object arrays"):
        store.save_task("k", {"x": np.array([Bomb()], dtype=object)})
    assert store.load_task("k") is None
    np.savez(store.partial / "k.npz", x=np.array([Bomb()], dtype=object))
    assert store.load_task("k") is None
    (store.partial / "k.npz").write_bytes(pickle.dumps(Bomb()))
    assert store.load_task("k") is None
    assert not Bomb.exploded


def test_read_json_says_what_is_wrong(tmp_path):
    path = tmp_path / "x.json"
    for prepare, expected in (
        (lambda: None, "no such file"),
        (lambda: path.write_text("[1]"), "found a list, expected a JSON object"),
        (lambda: path.write_text("{"), "not JSON"),
        (lambda: path.write_bytes(b"\xff"), "not UTF-8"),
    ):
        prepare()
        assert re.search(expected, line_of(read_json, path))


def test_a_task_of_another_run_is_not_finished(store):
    store.save_task("k", ARRAYS)
    task = (store.partial / "k.npz").read_bytes()
    begun = store.begin({**IDENTITY, "config": {"seed": 2}}, resume=False)
    (begun.partial / "k.npz").write_bytes(task)
    assert begun.load_task("k") is None
    begun.save_task("k", ARRAYS)
    assert begun.load_task("k") is not None


# --- files of others -------------------------------------------------------------------------------------------------


def test_files_of_others_stay_in_the_results(store, voice):
    fill(store.stage(), "old")
    write_manifest(store.staged)
    store.publish()
    (store.out / "notes").mkdir()
    for name in ("letter.txt", "notes/one.txt", "tables/mine.csv"):
        (store.out / name).write_text("mine")
    store.begin(IDENTITY, resume=False)
    fill(store.stage(), "new")
    write_manifest(store.staged)
    store.publish()
    assert contents(store.out) == {"new"}
    for name in ("letter.txt", "notes/one.txt", "tables/mine.csv"):
        assert (store.out / name).read_text() == "mine"
    assert list_names(store.out.parent) == ["study"]
    check_whole(store.out, expected=True)  # whose own files they are is known
    (store.out / "notes" / "two.txt").write_text("mine")
    with pytest.raises(InputError, match=r"found notes/two.txt added,"):
        check_whole(store.out, expected=True)


def test_a_file_of_others_among_the_work_is_named_and_stays(store):
    (store.partial / "thesis.tex").write_text("precious")
    for resume in (False, True):
        with pytest.raises(InputError, match=r"thesis\.tex: found no"):
            store.begin(IDENTITY, resume=resume)
    publish(store, "new")
    assert contents(store.out) == {"new"}
    assert (store.partial / "thesis.tex").read_text() == "precious"


def test_a_directory_that_looks_staged_is_left_alone(store):
    beside = store.out.with_name("study.new.partial")
    beside.mkdir()
    (beside / "thesis.tex").write_text("precious")
    publish(store, "new")
    assert (beside / "thesis.tex").read_text() == "precious"
