"""Classes from a file beside a config, or from an installed package, instead of built-in ones."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys

import audit_problems as problems
import own_classes
import pandas as pd
import pytest
import studies

from bayescal.config.classes import find_files
from bayescal.errors import InputError
from bayescal.experiments.audit.audit import analyse
from bayescal.experiments.audit.design import read_plans
from bayescal.experiments.runner.identity import identify
from bayescal.experiments.runner.load import load, load_experiment
from bayescal.experiments.runner.run import compute_experiment
from bayescal.experiments.runner.store import Store
from bayescal.experiments.selection.inputs import read_selection
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.machines.read import load_mechanism

pytestmark = pytest.mark.runs

AUDIT = """
extends = "base.toml"
n_simulated_calibrations = 0
n_prior_draws = 0
profiles = ["l[1]"]
model_error = { terms = ["random"] }

[[variants]]
model = "six_ups"
sensors = ["rho", "own"]

[sensors.own]
kind = "own.py:Tracker"
noise_um = 10.0

[sweep]
noise = [1.0]
poses = [10]
workspace = [1.0]
"""


def read_json(path):
    return json.loads(path.read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a folder with a tiny study of own classes."""
    return own_classes.write_study(tmp_path_factory.mktemp("own")).parent


# --- studies -----------------------------------------------------------------------------------------------------


def test_a_study_of_an_own_model_and_deformation(call, tmp_path, no_pictures, search_little):
    path = own_classes.write_study(tmp_path, own_classes.ONE_VARIANT)
    code, _, complaint = call("run", path, "--out", tmp_path / "out1", "--workers", 1, "--quiet")
    assert code in (0, 3), complaint  # so few draws do not
    summary = read_json(tmp_path / "out1" / "summary.json")
    other = compute_experiment(load_experiment(path), tmp_path, workers=2).summary
    assert list(summary["variants"]) == ["longer/halved"]
    title = summary["models"]["longer"]
    assert f'"{title}"' in (tmp_path / "own.py").read_text()
    fit, again = (one["variants"]["longer/halved"] for one in (summary, other))
    assert fit["log_evidence"] == again["log_evidence"]
    lengths = load_mechanism(tmp_path / "mechanism.toml").leg_lengths
    found = studies.read_posterior(tmp_path / "out1", "longer/halved")
    assert found["l[1]"]["nominal"] == pytest.approx(lengths[0] + 0.5)
    assert (tmp_path / "out1" / "posterior" / "longer-halved.nc").is_file()
    provenance = read_json(tmp_path / "out1" / "provenance.json")
    assert "own.py" in provenance["files"]
    assert provenance["config"]["variants"][0]["model"] == {"class": "own.py:Longer", "longer_mm": 0.5}
    assert str(tmp_path) not in (tmp_path / "out1" / "provenance.json").read_text()
    assert title in (tmp_path / "out1" / "report.html").read_text()
    studies.edit(tmp_path / "own.py", "with a twist", "with another twist")
    code, _, complaint = call("run", path, "--out", tmp_path / "out1", "--quiet")
    assert code == 2
    assert "another config" in complaint


def test_a_variant_is_of_its_own_classes(folder):
    inputs = StudyInputs.load(load_experiment(folder / "study.toml"), folder)
    assert [variant.name for variant in inputs.config.variants] == ["longer/none", "six_pus/halved"]
    machine = inputs.variants["six_pus/halved"].whole.machine
    assert machine.layout.nominal[machine.layout.index["kappa"]] == pytest.approx(0.0055)


def test_a_changed_file_is_another_class(tmp_path):
    path = own_classes.write_study(tmp_path)
    before = load_experiment(path).variants[0].name
    studies.edit(tmp_path / "own.py", 'name = "longer"', 'name = "longest"')
    assert (before, load_experiment(path).variants[0].name) == ("longer/none", "longest/none")


def test_a_twin_of_an_own_model(call, tmp_path):
    path = own_classes.write_study(tmp_path).with_name("simulate.toml")
    path.write_text(path.read_text().replace('"six_pus"', '"own.py:Longer"'))
    assert call("simulate", path, "--out", tmp_path / "data2")[0] == 0
    assert "own.py" in find_files(load_experiment(path), path.parent)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("longer_mm = 0.5", "longre_mm = 0.5", "unknown key, did you mean 'longer_mm'?, expected one of longer_mm"),
        ("longer_mm = 0.5", "longer_mm = -1.0", "longer_mm: found -1.0, expected greater than"),
        ("own.py:Longer", "own.py:Shorter", "model: found 'own.py:Shorter', expected a subclass"),
        ("own.py:Longer", "own.py:Tracker", "model: found 'own.py:Tracker', expected a subclass"),
        ("own.py:Longer", "nowhere.py:Longer", "nowhere.py: no such"),
        ("own.py:Longer", "no.such:Longer", "found 'no.such:Longer', expected file.py:Class"),
        ('{ class = "own.py:Longer", longer_mm = 0.5 }', '"six_puss"', "found 'six_puss', did you mean 'six_pus'?"),
        ('{ class = "own.py:Longer", longer_mm = 0.5 }', "3", "model: found 3, expected a name, or a table"),
        ('{ class = "own.py:Longer", longer_mm = 0.5 }', '"own.py:Nameless"', "named 'six_pus', expected no built-in"),
        ("own.py:Longer", "own.py:Failing", "class Failing fails with RuntimeError: no blocks here"),
        ("own.py:Halved", "own.py:Longer", "deformation: found 'own.py:Longer', expected a subclass of Deformation"),
        ('"six_pus"', '{ class = "six_pus", depth = 1 }', "depth: unknown key, expected none"),
    ],
)
def test_faults_of_a_study_are_one_line(refuse, folder, tmp_path, old, new, message):
    path = folder / f"{tmp_path.name}.toml"
    shutil.copy(folder / "study.toml", path)
    studies.edit(path, old, new)
    assert "variant" in refuse(re.escape(message), tmp_path / "sub" / "out", "run", path)
    assert not (tmp_path / "sub").exists()


def test_files_and_lines_are_named(folder, tmp_path):
    path = folder / "lines.toml"
    shutil.copy(folder / "study.toml", path)
    studies.edit(path, "longer_mm", "longre_mm")
    with pytest.raises(InputError, match=rf"^{path}, line \d+: variants\.0\.model\.longre_mm: unknown"):
        load_experiment(path)


def test_nothing_is_imported_that_is_not_named(tmp_path):
    path = studies.write_tiny_study(tmp_path)
    (tmp_path / "own.py").write_text("raise RuntimeError('imported')")
    assert StudyInputs.load(load_experiment(path), tmp_path).config.variants[0].name == "six_pus/none"


# --- pose selection ----------------------------------------------------------------------------------------------


def test_an_own_criterion_and_method(call, tmp_path):
    path = own_classes.write_selection(tmp_path)
    for workers in (1, 2):
        code, _, complaint = call("run", path, "--out", tmp_path / f"out{workers}", "--workers", workers, "--quiet")
        assert (code, complaint) == (0, "")
    one, two = (pd.read_csv(tmp_path / f"out{n}" / "selections.csv") for n in (1, 2))
    pd.testing.assert_frame_equal(one, two)
    assert list(one["label"]) == ["foremost", "foremost", "exchange"]
    assert list(one["criterion"]) == ["D", "weighted", "weighted"]
    assert one["value"][1] == pytest.approx(3.0 * one["value"][0])
    assert one["value"][2] > one["value"][1]
    assert (tmp_path / "out1" / "plans" / "foremost_weighted_8.csv").is_file()
    assert "own.py" in read_json(tmp_path / "out1" / "provenance.json")["files"]
    (tmp_path / "own.py").unlink()
    page = tmp_path / "out1" / "report.html"
    before = page.read_text()
    assert call("report", tmp_path / "out1")[0] == 0
    assert page.read_text() == before
    assert all(text in before for text in ("Information, weighted", "Nobody 2026", "The first candidates"))


def test_a_run_of_other_code_is_not_resumed(refuse, tmp_path):
    path = own_classes.write_selection(tmp_path)
    experiment, config = load(path)
    assert experiment.modules(config, tmp_path) == {}  # the file stands among the files
    Store(tmp_path / "out").begin(identify(config, tmp_path, experiment.files(config, tmp_path)), resume=False)
    studies.edit(tmp_path / "own.py", "with a twist", "with another twist")
    refuse("cannot resume, the config differs: files.own.py", tmp_path / "out", "run", path, "--resume")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("skip = 2", "skpi = 2", "selections.0.skpi: unknown key, did you mean 'skip'?"),
        ("skip = 2", 'skip = "two"', "selections.0.skip: found 'two', expected a valid integer"),
        ("own.py:Foremost", "exchagne", "found 'exchagne', did you mean 'exchange'?"),
        ("own.py:Foremost", "own.py:Weighted", "expected a subclass of SelectionMethod"),
        (", weight = 3.0", "", "weight: missing"),
        ('criteria = ["D"', 'criteria = ["O6"', "found 'O6', expected one of A, D, I, O1"),
        ("weight = 3.0", "weight = 2.0", "found two criteria named 'weighted'"),
        ("own.py:Tracker", "own.py:Bare", "found 'own.py:Bare' without information"),
        ("own.py:Tracker", "own.py:Lying", "found information of shape (6,)"),
        ("noise_um = 10.0\n", "", "sensors.tracker.noise_um: missing"),
        ("noise_um = 10.0\n", "noise_mu = 10.0\n", "sensors.tracker.noise_mu: unknown key, did you mean 'noise_um'?"),
        ("own.py:Tracker", "sextant", "sensors.tracker.kind: found 'sextant', expected one of pose, targets"),
        ('kind = "own.py:Tracker"\n', "", "sensors.tracker.kind: missing"),
    ],
)
def test_faults_of_a_selection_are_one_line(refuse, tmp_path, old, new, message):
    path = own_classes.write_selection(tmp_path)
    studies.edit(path, old, new)
    refuse(re.escape(message), tmp_path / "out", "run", path)


def test_continuous_starts_from_an_own_method(tmp_path):
    path = own_classes.write_selection(tmp_path)
    start = 'method = "continuous"\nstart = { class = "own.py:Foremost", skip = 4 }'
    studies.edit(path, 'method = "exchange"', start)
    inputs = read_selection(load_experiment(path), tmp_path)
    assert inputs.method(inputs.config.selections[1]).start.skip == 4


# --- audits ------------------------------------------------------------------------------------------------------


def test_an_audit_with_an_own_sensor(call, tmp_path, no_pictures):
    shipped = (problems.DESIGNS / "camera_hexapod.toml").read_text()
    shipped = shipped.replace('"camera_hexapod_mechanism', f'"{problems.DESIGNS}/camera_hexapod_mechanism')
    (tmp_path / "base.toml").write_text(shipped)
    (tmp_path / "own.py").write_text(own_classes.OWN)
    built_in = AUDIT.replace('"own.py:Tracker"\nnoise_um = 10.0', '"pose"\nposition_um = 10.0')
    for name, text in (("own", AUDIT), ("plain", built_in)):
        (tmp_path / f"{name}.toml").write_text(text)
    code, _, complaint = call("audit", tmp_path / "own.toml", "--out", tmp_path / "own", "--workers", 1, "--quiet")
    assert (code, complaint) == (0, "")
    (plan,) = read_plans(load_experiment(tmp_path / "plain.toml"), tmp_path).values()
    plain = analyse(plan)
    assert read_json(tmp_path / "own" / "summary.json")["total_nats"] == plain.information.nats
    assert "own.py" in read_json(tmp_path / "own" / "provenance.json")["files"]


def test_an_audit_of_a_study_of_own_classes(folder):
    path = folder / "audit.toml"
    text = 'kind = "audit"\nname = "own"\ntitle = "Own"\nseed = 1\ndata = { study = "study.toml" }\n[[variants]]\n'
    path.write_text(text + 'model = { class = "own.py:Longer", longer_mm = 0.5 }\n')
    experiment, config = load(path)
    assert experiment.read(config, folder).measured.model.machine.model.longer == 0.5
    assert {"own.py", "study.toml", "mechanism.toml"} <= set(experiment.files(config, folder))
    studies.edit(path, "own.py:Longer", "own.py:Renamed")
    (folder / "own.py").write_text(own_classes.OWN + "\n\nclass Renamed(Longer):\n    name = 'renamed'\n")
    with pytest.raises(InputError, match=r"renamed/none,.*longer/none, six_pus/halved"):
        experiment.read(load(path)[1], folder)
    (folder / "own.py").write_text(own_classes.OWN)


# --- installed packages --------------------------------------------------------------------------------------------


def test_an_installed_package_offers_its_classes_by_name(tmp_path):
    site, path = tmp_path / "site", own_classes.write_selection(tmp_path)
    about = site / "extras-1.0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: extras\nVersion: 1.0\n")
    offered = {"criteria": "Weighted", "methods": "Foremost", "sensors": "Tracker", "models": "Longer"}
    groups = [f"[bayescal.{group}]\n{name.lower()} = extras:{name}\n" for group, name in offered.items()]
    (about / "entry_points.txt").write_text("\n".join(groups))
    (tmp_path / "own.py").rename(site / "extras.py")
    text = path.read_text().replace('"six_pus"', '"extras:Longer"')
    for name in offered.values():
        text = text.replace(f"own.py:{name}", name.lower())
    path.write_text(text)
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), os.environ.get("PYTHONPATH", "")])}

    def run(*options):
        command = [sys.executable, "-m", "bayescal", "run", str(path), "--out", str(tmp_path / "out"), *options]
        return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)

    done = run("--workers", "2", "--quiet")
    assert (done.returncode, done.stderr) == (0, "")
    provenance = (tmp_path / "out" / "provenance.json").read_text()
    assert set(json.loads(provenance)["modules"]) == {"extras"}
    assert str(tmp_path) not in provenance
    assert "extras" in (tmp_path / "out" / "report.html").read_text()
    studies.edit(site / "extras.py", "with a twist", "with another twist")
    again = run("--quiet")
    assert again.returncode == 2
    assert "another config" in again.stderr
