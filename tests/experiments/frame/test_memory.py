"""An experiment that would take more memory than there is is refused before it computes."""

from __future__ import annotations

import pytest
import studies

from bayescal.errors import InputError
from bayescal.experiments.audit.kind import Audit
from bayescal.experiments.frame import memory
from bayescal.experiments.frame.load import load_experiment
from bayescal.experiments.frame.memory import GIB, Need, check_memory, measure_available
from bayescal.experiments.frame.run import run_experiment
from bayescal.experiments.pose_selection.kind import PoseSelection

NEED = Need(shared=1.0 * GIB, each=2.0 * GIB, sizes="many poses", remedy="fewer poses")


def test_every_process_counts(monkeypatch):
    monkeypatch.setattr(memory, "measure_available", lambda: 5.0 * GIB)
    check_memory(NEED, 1)
    with pytest.raises(
        InputError, match=r"memory: found many poses, which take about 5.8 GiB with 2 workers, with 5.0 "
    ):
        check_memory(NEED, 2)
    check_memory(NEED, 0)  # others compute
    check_memory(Need(), 100)  # nothing is known


def test_a_system_that_does_not_say_refuses_nothing(monkeypatch):
    monkeypatch.setattr(memory, "measure_available", lambda: None)
    check_memory(NEED, 1000)


def test_the_system_says_what_there_is():
    assert 0.0 < measure_available() < 2.0**50


def test_a_container_is_smaller_than_its_host(monkeypatch, tmp_path):
    for name, text in (("max", f"{2**30}"), ("stat", "anon 5\ninactive_file 1024\n"), ("use", f"{2**29}")):
        (tmp_path / name).write_text(text)
    monkeypatch.setattr(memory, "CGROUPS", [[str(tmp_path / name) for name in ("max", "stat", "use")]])
    assert measure_available() == 2.0**29 + 1024


def test_a_study_is_refused_and_writes_nothing(monkeypatch, tmp_path):
    path = studies.write_tiny_study(tmp_path)
    monkeypatch.setattr(memory, "measure_available", lambda: 0.2 * GIB)
    with pytest.raises(InputError, match=r"found 16 poses, 13 parameters and 4 posteriors, .* expected fewer poses"):
        run_experiment(load_experiment(path), path.parent, tmp_path / "out")
    assert not list(tmp_path.glob("out*"))


@pytest.mark.parametrize(
    ("kind", "name", "key", "part"),
    [
        (Audit, "audit/m2_hexapod.toml", "poses", {"count": 4000}),
        (PoseSelection, "pose_selection/hexapod_i_optimal.toml", "candidates", {"count": 100_000}),
    ],
)
def test_estimates_grow_with_the_sizes(kind, name, key, part):
    path = studies.EXPERIMENTS / name
    config = load_experiment(path)
    experiment = kind()
    few = experiment.estimate_memory(experiment.read(config, path.parent))
    section = getattr(config, key).model_copy(update=part)
    many = experiment.estimate_memory(experiment.read(config.model_copy(update={key: section}), path.parent))
    assert many.each > 20.0 * few.each
    assert str(part["count"]) in many.sizes
