"""An experiment that would take more memory than there is is refused before it computes."""

from __future__ import annotations

import re

import calibrated_machines as made_up
import pytest
import studies
import telescope_machines as machines

from bayescal.calibrated.formats import export_machine
from bayescal.errors import InputError
from bayescal.experiments.audit.kind import Audit
from bayescal.experiments.runner import memory
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.runner.memory import GIB, MemoryEstimate, check_memory, estimate_arrays, measure_available
from bayescal.experiments.runner.run import run_experiment
from bayescal.experiments.selection.kind import Selection

DEGREES = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
NEED = MemoryEstimate(shared=1.0 * GIB, each=2.0 * GIB, sizes="many poses", remedy="fewer poses")


def test_every_process_counts(monkeypatch):
    monkeypatch.setattr(memory, "measure_available", lambda: 5.0 * GIB)
    check_memory(NEED, 1)
    with pytest.raises(InputError, match=r"memory: .*many poses.* 5\.8 GiB .*2 workers.* 5\.0 "):
        check_memory(NEED, 2)
    check_memory(NEED, 0)  # others compute
    check_memory(MemoryEstimate(), 100)  # nothing is known
    monkeypatch.setattr(memory, "measure_available", lambda: None)  # a system that does not say
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
    with pytest.raises(InputError, match=r"16 poses.* 12 parameters.* 2 variants.* fewer poses"):
        run_experiment(load_experiment(path), path.parent, tmp_path / "out")
    assert not list(tmp_path.glob("out*"))


@pytest.mark.parametrize(
    ("kind", "name", "key", "most"),
    [
        (Audit, "sliding_star/m2_hexapod_sensors.toml", "poses", 6000),
        (Selection, "pose_selection/hexapod_i_optimal.toml", "candidates", 3000),
    ],
)
def test_estimates_grow_with_the_sizes(kind, name, key, most):
    path, experiment = studies.EXPERIMENTS / name, kind()
    config, found = load_experiment(path), []
    for count in (60, most):
        section = getattr(config, key).model_copy(update={"count": count})
        found.append(experiment.estimate_memory(experiment.read(config.model_copy(update={key: section}), path.parent)))
        assert str(count) in found[-1].sizes
    assert found[1].each > 20.0 * found[0].each


def test_sizes_are_counted_in_doubles():
    found = estimate_arrays({"poses": 10, "draws": 5}, [(3, 10, 5), (2, 7)], "fewer", kept=[(10,)])
    assert (found.each, found.shared, found.remedy) == (8.0 * 164, 80.0, "fewer")
    assert re.findall(r"\d+ \w+", found.sizes) == ["10 poses", "5 draws"]


def test_tables_that_do_not_fit_are_not_read(monkeypatch, tmp_path):
    path = studies.write_tiny_study(tmp_path)
    monkeypatch.setattr(memory, "READING", 1e9)
    with pytest.raises(InputError, match=r"memory: found 0 MB .*\(targets\.csv "):
        run_experiment(load_experiment(path), path.parent, tmp_path / "out")


@pytest.mark.parametrize(("command", "numbers"), [("predict", 216 + 120 * 100_000), ("compensate", 216 + 120)])
def test_more_poses_than_there_is_memory_for_are_one_line(command, numbers, call, monkeypatch, tmp_path, rng):
    machine = made_up.build_made_up(machines.build_machine("linear"), rng)
    export_machine(machine, tmp_path / "machine", "mechanism")
    names = [f"rho_{leg}_mm" for leg in range(1, 7)] if command == "predict" else DEGREES
    (tmp_path / "many.csv").write_text(
        f"pose,{','.join(names)}\n" + "".join(f"P{k},10,10,10,10,10,10\n" for k in range(50))
    )
    more = ["--draws-out", tmp_path / "draws.csv", "--n-draws", 100_000] if command == "predict" else []
    monkeypatch.setattr(memory, "measure_available", lambda: 50 * 8.0 * numbers - 1.0)
    code, said, complaint = call(command, tmp_path / "machine", tmp_path / "many.csv", *more)
    assert (code, said, complaint.count("\n")) == (2, "", 1)
    assert complaint.startswith("bayescal: memory: found 50 poses"), complaint
    assert not (tmp_path / "draws.csv").exists()
