"""The command line as its users meet it: exit codes, one line on standard error, nothing written on bad input."""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import audit_problems
import hexapod_settings
import numpy as np
import pytest
import studies
from efforts import searching_little

from bayescal.cli import app
from bayescal.errors import NumericalError
from bayescal.experiments.runner import run as frame
from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.simulation.compute import build_twin
from bayescal.experiments.study import compute
from bayescal.files.csv_tables import read_table
from bayescal.machines.kinematics import solve_forward_kinematics

COMMANDS = [one.name or one.callback.__name__ for one in app.registered_commands]
SESSIONS = ("sessions", "january", "february", "march", "april", "may", "june")
ENVIRONMENT = {**os.environ, "OMP_NUM_THREADS": "1"}


@pytest.fixture
def study(tmp_path, monkeypatch) -> Path:
    """Return the config of a tiny study with its data, in the current directory."""
    monkeypatch.chdir(tmp_path)
    return studies.write_tiny_study(tmp_path).relative_to(tmp_path)


@pytest.fixture
def quick(monkeypatch) -> None:
    """Leave the page out of the results: its figures take most of a tiny study's time."""
    monkeypatch.setattr(frame, "write_page", lambda page, folder, *more: folder)


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    """Return the results of a tiny study, without a page, of which tests take copies."""
    folder = tmp_path_factory.mktemp("finished")
    path = studies.write_tiny_study(folder)
    with pytest.MonkeyPatch.context() as patched, searching_little():
        patched.setattr(frame, "write_page", lambda page, folder, *more: folder)
        frame.run_experiment(load_experiment(path), folder, folder / "out")
    return folder / "out"


# --- help and usage --------------------------------------------------------------------------------------------------


def test_without_a_command_there_is_help_that_lists_all(call):
    for arguments in ((), ("--help",)):
        code, out, err = call(*arguments)
        assert (code, err) == (0, "")
        assert all(f"\n  {command} " in out for command in COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_help_of_every_command_shows_an_example(call, command):
    code, out, err = call(command, "--help")
    assert (code, err) == (0, "")
    assert f"Example: bayescal {command} " in " ".join(out.split())
    if command in ("run", "audit", "sweep", "next-pose", "selftest", "table"):
        assert all(f"--{one}" in out for one in ("out", "seed", "workers", "dask-scheduler", "resume", "quiet"))


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (("rum",), "No such command 'rum'"),
        (("run",), "Missing argument"),
        (("run", "study.toml", "--wokers", "2"), "No such option: --wokers"),
        (("run", "study.toml", "--workers", "two"), "--workers"),
        (("run", "study.toml", "--workers", "0"), "--workers"),
        (("run", "study.toml", "--seed", "-1"), "--seed"),
        (("run", "study.toml", "--seed", "1.5"), "--seed"),
        (("run", "study.toml", "another.toml"), "unexpected extra argument"),
        (("simulate", "simulate.toml"), "--out"),
        (("compare",), "Missing argument"),
        (("report", "a", "b"), "unexpected extra argument"),
    ],
)
def test_wrong_usage(refuse_here, study, arguments, expected):
    message = refuse_here(*arguments)
    assert expected.lower() in message.lower()
    assert "--help" in message


# --- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "old", "new", "expected"),
    [
        ("study.toml", "seed = 11", 'seed = "11"', "study.toml, line 5: seed: found '11', expected a valid integer"),
        ("study.toml", "seed = 11", '"a\\nb" = 11', "unknown key"),
        ("study.toml", "data/targets.csv", "data/target.csv", "data/target.csv: no such file"),
        ("mechanism.toml", "radius_mm = 155.0", "radius_cm = 15.5", "mechanism.toml, line 7: base.radius_cm: unknown"),
        ("data/targets.csv", "x_mm", "x_in", "data/targets.csv, line 3: found column 'x_in', did you mean 'x_mm'?"),
        ("data/targets.csv", "C01,base,B02,", "C01,base,B02,?", "data/targets.csv, line 5: x_mm: found '?"),
        ("data/actuators.csv", "C02,", "C01,", "data/actuators.csv, line 5: pose 'C01' is already on line 4"),
        ("data/actuators.csv", "rho_6_mm", "rho_6", "data/actuators.csv, line 3: found column 'rho_6'"),
        ("data/target_reference.csv", "B02", "B01", "data/target_reference.csv, line 5: target 'base/B01' is already"),
    ],
)
@pytest.mark.parametrize("command", ["run", "poses-from-targets"])
def test_bad_input_is_one_line_and_nothing_written(refuse_here, study, command, name, old, new, expected):
    studies.edit(Path(name), old, new)
    assert expected in refuse_here(command, study, "--out", "new/out")


def test_kind_of_another_command(refuse_here, study):
    figure5 = studies.EXPERIMENTS / "rr8096" / "figure5.toml"
    for command, path, kind, expected in (
        ("simulate", study, "study", "simulation"),
        ("audit", study, "study", "audit"),
        ("audit", "simulate.toml", "simulation", "audit"),
        ("poses-from-targets", figure5, "pose_methods.py:PoseMethods", "study"),
    ):
        assert f"kind: found {kind!r}, expected {expected!r}" in refuse_here(command, path, "--out", "x")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_out_without_permission(refuse_here, study, tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    refuse_here("run", study, "--out", "locked/out")


FULL = {"disk": errno.ENOSPC, "quota": errno.EDQUOT, "ulimit -f": errno.EFBIG}
FAILURES = {
    "numbers": (NumericalError("as if"), "as if"),
    **{
        name: (OSError(fault, os.strerror(fault), "out"), f"out: {os.strerror(fault)}, expected room to write")
        for name, fault in FULL.items()
    },
}


@pytest.mark.parametrize("failure", FAILURES)
def test_a_failure_on_the_way_is_3_in_one_line(failure, call, study, monkeypatch, quick):
    error, said = FAILURES[failure]

    def fail(*_):
        raise error

    monkeypatch.setattr(compute, "fit_variant", fail)
    code, _, err = call("run", study, "--out", "out", "--workers", 1, "--quiet")
    assert (code, err.count("\n")) == (3, 1)
    assert err.startswith("bayescal: ")
    assert said in err
    assert not Path("out").exists()


# --- run -------------------------------------------------------------------------------------------------------------


@pytest.mark.runs
def test_not_converged_is_3_with_the_results_written(call, study, quick, search_little):
    code, out, err = call("run", study, "--out", "out", "--workers", 1)
    assert code == 3
    assert "sampling: 2 of 2" in err
    (error,) = studies.list_errors(err)
    assert error.startswith("bayescal: ")
    assert "six_pus/matrix" in out
    assert "NOT CONVERGED six_pus/none" in out
    assert json.loads(Path("out/summary.json").read_text())["seed"] == 11
    assert not list(Path().glob("*.partial"))

    code, out, err = call("run", study, "--seed", 5, "--workers", 1, "--quiet")  # to a place of its own
    assert (code, out, err.count("\n")) == (3, "", 1)
    assert err.startswith("bayescal: results/tiny: ")
    assert json.loads(Path("results/tiny/summary.json").read_text())["seed"] == 5


def keep_first_variant(path: Path) -> None:
    text = path.read_text()
    _, _, second = text.split("[[variants]]")
    text = text.replace(f"[[variants]]{second}", second[second.index("[sampler]") :])
    path.write_text(text.replace('kappa = { prior = "normal", sd = 0.01 }\n', ""))  # nobody else frees it


@pytest.mark.runs
def test_converged_is_0_without_errors(call, study, quick):
    path = Path(study)
    keep_first_variant(path)
    studies.edit(path, "walkers = 8", "walkers = 64")
    studies.edit(path, "burn_in = 5\nsteps = 10", "burn_in = 20\nsteps = 60")
    studies.edit(path, "draws = 1000\nmax_draws = 1000", "draws = 4000\nmax_draws = 4000")
    code, out, err = call("run", study, "--out", "out", "--workers", 1)
    assert (code, studies.list_errors(err)) == (0, [])
    assert "NOT CONVERGED" not in out
    assert "report: out/report.html" in out


@pytest.mark.runs
def test_a_narrow_uniform_prior_is_no_failure(call, study, quick, search_little):
    """Bounds that the measurements contradict squeeze the posterior against them; that is a result."""
    keep_first_variant(Path(study))
    studies.edit(Path(study), 'prior = "normal", sd = 2.0', 'prior = "uniform", half_width = 0.001')
    code, _, err = call("run", study, "--out", "out", "--workers", 1)
    assert code in (0, 3)
    assert len(studies.list_errors(err)) <= 1
    assert Path("out/summary.json").exists()


def test_console_script_refuses_in_one_line(study, tmp_path):
    script = Path(sys.executable).with_name("bayescal")
    done = subprocess.run(
        [script, "run", "nothing.toml"], cwd=tmp_path, env=ENVIRONMENT, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("bayescal: nothing.toml: ")


# --- simulate, poses-from-targets ------------------------------------------------------------------------------------


def test_simulate_writes_the_survey(call, study):
    code, out, err = call("simulate", "simulate.toml", "--out", "new/data")
    assert (code, err) == (0, "")
    assert out.count("wrote new/data/") == 5
    written = {f"data/{p.name}": p.read_text() for p in Path("new/data").iterdir()}
    truth = {f"data/true_{what}.csv" for what in ("parameters", "poses")}
    assert {name: text for name, text in written.items() if name not in truth} == studies.tiny_survey_texts()
    assert truth < written.keys()
    assert call("simulate", "simulate.toml", "--out", "other", "--seed", 7)[0] == 0
    assert Path("other/targets.csv").read_text() != Path("new/data/targets.csv").read_text()


@pytest.mark.parametrize("to_file", [True, False], ids=["file", "standard output"])
def test_poses_match_the_true_ones(call, study, to_file):
    code, out, err = call("poses-from-targets", study, *(("--out", "new/poses.csv") if to_file else ()))
    assert (code, err) == (0, "")
    if not to_file:
        Path("new").mkdir()
        Path("new/poses.csv").write_text(out)
    table = read_table(Path("new/poses.csv"), None)
    position = table.numbers(("x_mm", "y_mm", "z_mm"))
    config = load_experiment(Path("simulate.toml"))
    twin = build_twin(config, Path())
    travel = np.concatenate([twin.calibration, twin.verification])
    truth = solve_forward_kinematics(twin.machine, twin.theta, twin.mechanism.initial_actuator_positions + travel)
    assert table.text("use") == ["calibration"] * studies.N_CALIBRATION + ["verification"] * studies.N_VERIFICATION
    # the covariance leaves out the actuators' 1 µm, which moves the truth by some µm
    sd = 1e-3 * np.sqrt(table.numbers(("cov_x_x", "cov_y_y", "cov_z_z")))
    assert (np.abs(position - truth.position) < 5 * np.hypot(sd, 0.005)).all()
    assert "Simulated, " in Path("new/poses.csv").read_text().splitlines()[0]


def test_method_of_poses(call, refuse_here, study):
    robust = call("poses-from-targets", study)[1]
    assert call("poses-from-targets", study, "--method", "robust")[1] == robust
    assert re.search("--method: found 'robst'.*'robust'", refuse_here("poses-from-targets", study, "--method", "robst"))


# --- report, compare -------------------------------------------------------------------------------------------------


def test_report_of_what_is_no_results_directory(refuse_here, study):
    assert "nowhere" in refuse_here("report", "nowhere")
    refuse_here("report", "data")
    refuse_here("report", "study.toml")


@pytest.mark.parametrize(
    ("provenance", "expected"),
    [
        ("[]", "found a list, expected a JSON object"),
        ("{}", "found no tables"),
        ('{"kind": "study", "tables": 1}', "found no tables"),
        ('{"kind": "study", "tables": {"x.csv": 1}}', "found no tables"),
        ('{"kind": "study", "tables": {"../x.csv": {}}}', "found '../x.csv', expected names of CSV files"),
        ('{"kind": "study", "tables": {"x.csv": {}}}', "x.csv: no such table"),
        ('{"tables": {}}', "found no kind of experiment"),
        ('{"kind": ["study"], "tables": {}}', "found no kind of experiment"),
        ('{"kind": "studdy", "tables": {}}', "kind: found 'studdy', did you mean 'study'?"),
        ('{"kind": "os:system", "tables": {}}', "found 'os:system', expected file.py:Class"),
        ('{"kind": "study", "tables": {}}', "summary.json: experiment: found nothing, expected str"),
        ('{"kind": "study", "tables": {"x.csv": {"a": ["text"]}}}', "x.csv: a: found kind ['text'] in provenance.json"),
        ('{"kind": "study", "tables": {}, "empty_tables": 3}', "empty_tables: found 3, expected lists of columns"),
        ('{"kind": "study", "tables": {}, "empty_tables": {"x": [3]}}', "empty_tables: found {'x': [3]}, expected"),
        ('{"kind": "simulation", "tables": {}}', "found damaged results (KeyError: 'n_poses')"),
        (
            '{"kind": "simulation", "tables": {}, "versions": {"bayescal": "0.0.1"}}',
            "bayescal 0.0.1 (KeyError: 'n_poses'),",
        ),
        ('{"kind": "selection", "tables": {}}', "found no valid config"),
        ('{"kind": "selection", "tables": {}, "config": 1}', "found damaged results (AttributeError: "),
    ],
)
def test_report_of_results_that_no_experiment_wrote(refuse_here, tmp_path, provenance, expected):
    (tmp_path / "provenance.json").write_text(provenance)
    (tmp_path / "summary.json").write_text("{}")
    if '"a"' in provenance:
        (tmp_path / "x.csv").write_text("a\n1\n")
    assert expected in refuse_here("report", tmp_path)


@pytest.mark.runs
def test_compare_ranks_studies_of_the_same_data(call, refuse_here, study, finished, quick, search_little):
    shutil.copytree(finished, "first")
    call("run", study, "--out", "second", "--workers", 1, "--seed", 12)
    code, out, err = call("compare", "first", "second")
    assert (code, err) == (0, "")
    assert out.index("six_pus/matrix") < out.index("six_pus/none")
    assert out.count("first") == out.count("second") == 2
    shutil.copytree("first", "third")
    digest = json.loads(Path("first/provenance.json").read_text())["files"]["data/actuators.csv"]
    studies.edit(Path("third/provenance.json"), digest, "0" * 64)
    assert "actuators differs" in refuse_here("compare", "first", "third")
    assert "nowhere" in refuse_here("compare", "first", "nowhere")
    refuse_here("compare", "data")
    Path("third/summary.json").write_text("{}")
    assert "third" in refuse_here("compare", "third")


# --- every experiment runs -------------------------------------------------------------------------------------------


STUDIES = [
    *(pytest.param(f"telescope/table{k}", 4, marks=pytest.mark.slow) for k in (5, 6, 7)),
    *(pytest.param(f"telescope/{name}", 12, marks=pytest.mark.slow) for name in ("study", "ridges")),
    pytest.param("telescope/model_error", 9, marks=pytest.mark.slow),
    ("m2_hexapod/study", 3),
    ("m2_hexapod/lengths", 1),
    ("camera_hexapod/study", 1),
    ("hexaglide/study", 2),
]


@pytest.mark.runs
@pytest.mark.parametrize(("name", "n_variants"), STUDIES)
def test_shipped_study_runs_tiny(call, tmp_path, quick, search_little, name, n_variants):
    path = studies.copy_small(studies.EXPERIMENTS / f"{name}.toml", tmp_path / "copy")
    kept = {f"C{k:02d}" for k in range(1, 16)} | {"V01"}
    for data in (path.parent / "data" / f"{table}.csv" for table in ("targets", "poses", "actuators")):
        if not data.exists():
            continue
        lines = data.read_text().splitlines()
        data.write_text("\n".join([*lines[:3], *(x for x in lines[3:] if x.split(",")[0] in kept)]) + "\n")
    code, out, err = call("run", path, "--out", tmp_path / "out", "--workers", 1)
    converged = json.loads((tmp_path / "out" / "summary.json").read_text())["converged"]
    assert (code, len(studies.list_errors(err))) == ((0, 0) if converged else (3, 1))
    config = load_experiment(path)
    assert len(config.variants) == n_variants
    assert all(variant.name in out for variant in config.variants)


FLSUN = ("machine", "study", "audit_heights", "audit_distances")
SLIDING_STAR = ("machine", "m2_hexapod_machine", "m2_hexapod_sensors", "sensors", "simulate", "study")


def test_every_shipped_experiment_is_run_here():
    found = {str(p.relative_to(studies.EXPERIMENTS)) for p in studies.EXPERIMENTS.rglob("*.toml")}
    names = [getattr(study, "values", study)[0] for study in STUDIES]
    assert found == {
        *(f"audit/{name}_mechanism.toml" for name in ("camera_hexapod", "m2_hexapod", "yu2023")),
        *(f"audit/{name}.toml" for name in (*audit_problems.SHIPPED, "telescope_posterior")),  # in audit/test_*.py
        "audit/m2_hexapod_tracker.toml",  # in sweep/test_sweep.py
        *(f"yu2023/{name}.toml" for name in (*hexapod_settings.SHIPPED, "small_mechanism")),  # in reproductions/yu2023
        "yu2023/table1.toml",  # in selection/test_selection_experiments.py
        "rr8096/figure5.toml",
        *(f"pose_selection/{name}.toml" for name in ("hexapod_i_optimal", "rr8096_figure14")),
        "sika2008/calibrations.toml",  # in test_self_calibrations
        *(f"sliding_star/{name}.toml" for name in SLIDING_STAR),  # in calibration/test_sliding_star.py
        *(f"hangprinter/{name}.toml" for name in ("machine", "hanging", "forces", "study")),  # in test_hangprinter
        *(f"flsun_v400/{name}.toml" for name in FLSUN),  # in machines/readings/test_delta.py
        *(f"ur10/{name}.toml" for name in ("machine", "study", "study_300")),  # in machines/readings/test_arm.py
        *(f"panda_socket/{name}.toml" for name in ("machine", "study")),  # there, too
        *(f"mmt_mount/{name}.toml" for name in ("machine", "study")),  # in machines/readings/test_mount.py
        *(f"jugglebot/{name}.toml" for name in ("drawn", "mechanism", "study")),  # in calibration/test_jugglebot.py
        *(
            f"m2_hexapod_table/{name}.toml" for name in ("machine", "simulate", "study", "table")
        ),  # in test_lookup_table
        "camera_hexapod/simulate.toml",
        "m2_hexapod/simulate.toml",
        *(f"m2_hexapod_sessions/{name}.toml" for name in SESSIONS),  # in sessions/test_*.py
        "m2_hexapod/next_pose.toml",  # in next_pose/test_next_pose_command.py
        *(f"hexaglide/{name}.toml" for name in ("mechanism", "simulate", "audit")),  # in test_hexaglide
        "telescope/mechanism.toml",
        "telescope/simulate.toml",
        *(f"{name}.toml" for name in names),
    }


@pytest.mark.parametrize(
    ("kind", "keys", "said"),
    [
        (
            "delta",
            "radius_mm = 150.0\narm_mm = 100.0\nendstop_mm = 300.0\nworkspace_radius_mm = 50.0",
            "arm_mm: found 100",
        ),
        ("mount", "azimuth_deg = [10.0, 5.0]", "azimuth_deg: found 10 to 5"),
        (
            "five_bar",
            "crank_mm = [9.0, 9.0]\ncoupler_mm = [9.0, 9.0]\nmotors_mm = [[0, 0], [0, 0]]",
            "motors_mm: found both",
        ),
        (
            "five_bar",
            "crank_mm = [9.0, 9.0]\ncoupler_mm = [9.0, 9.0]\nmotors_mm = [[0, 0], [9, 0]]",
            "q[1]: found nan at home",
        ),
    ],
)
def test_a_machine_that_cannot_be_is_one_line(call, tmp_path, kind, keys, said):
    more = {"delta": "workspace_height_mm = 9.0", "five_bar": "workspace_mm = [[0, 1], [90, 91]]"}.get(kind, "")
    path = tmp_path / "machine.toml"
    path.write_text(f'kind = "{kind}"\nname = "one"\ntitle = "One"\n[machine]\n{keys}\n{more}\n')
    code, _, complaint = call("show", path, "--out", tmp_path / "out.html")
    assert (code, complaint.count("\n")) == (2, 1)
    assert said in complaint
