"""Audits of a machine of one function: they agree with calibrations, with themselves, and refuse what cannot be."""

import html
import re

import calibrations
import numpy as np
import pandas as pd
import pytest

from bayescal.experiments.audit.design import read_design
from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.run import run_experiment
from bayescal.experiments.shared.readings.inputs import read_inputs
from bayescal.inference.exploration import explore
from bayescal.inference.importance import resample

pytestmark = pytest.mark.runs

POSES = 'file = "poses.csv"'


@pytest.fixture
def folder(tmp_path):
    path = calibrations.write_audit(tmp_path)  # of errors at the tool as they are, which no best fit takes away
    calibrations.change(path, "seed = 4\n", 'seed = 4\naccuracy_frame = "base"\n')
    path.write_text(path.read_text() + calibrations.SHORT_SWEEP)
    return path.parent


@pytest.fixture(scope="module")
def finished():
    """Return what was found of configs that name no file of poses, by their texts."""
    return {}


@pytest.fixture
def run(folder, finished, no_pictures):
    """Return a function that runs the audit with some texts of its config replaced: the results, the page's words.

    Of one set of sensors, as all are audited alike.
    """

    def run_changed(*changes, variant="both"):
        path = folder / "audit.toml"
        original = path.read_text()
        for old, new in changes:
            calibrations.change(path, old, new)
        text = re.sub(rf'(?s)\[\[variants\]\]\nname = "(?!{variant}").*?(?=\n\[)', "", path.read_text())
        path.write_text(text)
        if text not in finished or POSES in text:
            out = folder / f"out{len(list(folder.glob('out*')))}"
            done = run_experiment(load(path)[1], folder, out, quiet=True)
            page = html.unescape((out / "report.html").read_text()).replace("\xa0", " ")
            finished[text] = done.results, page
        path.write_text(original)
        return finished[text]

    return run_changed


def take(results, table, variant="both"):
    found = results.table(table)
    return found[found["variant"] == variant].reset_index(drop=True)


def state_error(stated):
    return ("[sensors]", f"[model_error]\n{stated}\n[sensors]")


ALONE = state_error('terms = ["random"]')  # functions of the pose take most of the time


def write_poses(folder, table):
    table.to_csv(folder / "poses.csv", index=False)
    return ("count = 40", POSES)


@pytest.mark.parametrize(("stated", "error"), [('terms = ["random"]', {}), ("expected_um = 0.0", None)])
def test_deviations_are_those_of_a_calibration_of_simulated_data(folder, run, stated, error):
    """Predicted at the poses of the data, against draws from the posterior of the data: another machine, with noise.

    Without a model error, and by default, of a machine that does not err.
    """
    true = pd.read_csv(folder / "data" / "true_poses.csv", comment="#")
    results, _ = run(write_poses(folder, true[true["pose"].str.startswith("C")]), state_error(stated))
    predicted = take(results, "parameters").set_index("parameter")
    config = load(folder / "study.toml")[1]
    config = config if error is None else config.model_copy(update={"model_error": error})
    variant = read_inputs(config, folder).variants["all"]
    posterior, rng = variant.posterior().with_pose_guesses(), np.random.default_rng(1)
    found = explore(posterior, np.random.SeedSequence(1), 48, max_pilots=0)
    drawn = resample(found.straight.log_density, found.proposal, rng, 16000, 2000)
    sd = posterior.natural(found.straight.y_from_x(drawn.draws)).std(axis=0)
    n = posterior.n_geometry
    share = (predicted["posterior_sd"] / predicted["prior_sd"]).loc[list(posterior.names[:n])]
    np.testing.assert_allclose((sd / posterior.prior_sd)[:n] / share, 1.0, atol=0.15)
    assert error is None or (predicted["posterior_sd"] < 0.5 * predicted["prior_sd"]).all()


def test_requirements_are_met_with_a_probability_that_falls_with_the_limit(run):
    results, page = run()
    found = take(results, "requirements").set_index("requirement")
    assert (found["rms_sd"] == found["predicted_sd"]).all()  # as the config requires
    assert (found["max_sd"] > found["rms_sd"]).all()
    assert (found["p_all_poses"] < found["probability"]).all()
    chance = found["probability"]["z"]
    assert 0.5 < chance < 1.0
    assert f"P = {100 * results.summary['variants']['both']['probability']:.0f} %" in page
    tight, _ = run(("z = 0.03 }", "z = 0.01 }"))
    assert take(tight, "requirements").set_index("requirement")["probability"]["z"] < 0.5 * chance
    always, _ = run(('requirement_applies_to = "rms"', 'requirement_applies_to = "all_poses"'))
    other = take(always, "requirements").set_index("requirement")
    np.testing.assert_allclose(other["predicted_sd"], found["max_sd"])
    np.testing.assert_allclose(other["probability"], found["p_all_poses"])


def test_larger_errors_tell_less_and_meet_less(run):
    """Parameters and requirements with no error, the expected one and three times it; what unseen ones would hide."""
    results, _ = run()
    sizes = results.table("error_sizes").pivot(index=["quantity", "name"], columns="size_factor", values="sd")
    assert (np.diff(sizes.to_numpy(), axis=1) > 0.0).all()
    best = take(results, "parameters").set_index("parameter")
    np.testing.assert_allclose(sizes[1.0]["parameter"]["t_x"], best["posterior_sd"]["t_x"])
    chances = (
        results.table("error_sizes")
        .dropna(subset="probability")
        .pivot(index="name", columns="size_factor", values="probability")
    )
    assert (np.diff(chances.to_numpy(), axis=1) <= 0.0).all()
    assert chances[3.0].min() < chances[0.0].min() - 0.15
    hidden = results.table("model_error_bias").set_index("parameter")
    assert (hidden["bias_rms"] > 0.0).all()
    assert (hidden["bias_rms"] < 0.7 * hidden["sd"]).all()
    stated, _ = run(state_error("floor_um = 10.0"))
    allowed = stated.table("model_error_bias").set_index("parameter")
    assert (allowed["sd"] > hidden["sd"]).all()


def test_noise_that_is_too_much_by_itself_is_said(run):
    results, _ = run(("x = 0.05", "x = 0.0001"), ALONE)
    assert take(results, "variants")["probability"][0] < 0.01


def test_chosen_poses_tell_what_they_promise(folder, run):
    """What is left after the last chosen pose is what an audit of just these poses finds."""
    results, _ = run(ALONE)  # poses are chosen as if all errors changed from pose to pose
    chosen = take(results, "selected")
    names = ["x_mm", "y_mm", "z_mm"]
    again, _ = run(write_poses(folder, chosen[names].assign(pose=[f"S{k}" for k in chosen["step"]])), ALONE)
    after = chosen[[f"parameter_error_{name}" for name in names]].to_numpy()
    np.testing.assert_allclose(take(again, "accuracy")["posterior_sd"], after[-1], rtol=1e-5)
    assert (np.diff((after**2).sum(axis=1)) < 0.0).all()


def test_chosen_poses_beat_as_many_random_ones(run):
    results, _ = run(("count = 40", "count = 4"), ("[sensors]", "[model_error]\nterms = []\n[sensors]"))
    chosen = take(results, "selected").iloc[-1][[f"parameter_error_{axis}_mm" for axis in "xyz"]]
    assert (chosen**2).sum() < 0.9 * (take(results, "accuracy")["posterior_sd"] ** 2).sum()


def test_fewer_equations_than_unknowns_are_said(run):
    results, page = run(("count = 40", "count = 4"), ALONE)
    assert take(results, "variants")["n_equations"][0] == 12
    assert "12 equations for 14" in page
    assert np.isfinite(take(results, "parameters")["posterior_sd"]).all()


def test_own_sensors_alone_tell_nothing_of_the_machine(run):
    results, page = run(('sensors = ["s", "height"]', 'sensors = ["s"]'), ALONE, variant="probe")
    found = take(results, "parameters", "probe")
    np.testing.assert_allclose(found["posterior_sd"], found["prior_sd"])
    assert set(found["verdict"]) == {"not"}
    assert "0 equations for 14" in page


def test_what_own_sensors_do_not_tell_is_not_met(run):
    results, _ = run(('sensors = ["s", "height"]', 'sensors = ["cam_x", "cam_y", "height"]'), variant="probe")
    assert (take(results, "requirements", "probe")["probability"] == 0.0).all()
    assert results.summary["variants"]["probe"]["sd_over_limit"] is None


def test_untold_parameters_are_named_by_the_machines_member(run):
    title = 'title = "Camera and probe"\n'
    _, page = run((title, f'{title}sensors = ["s", "cam_x", "cam_y"]\n'), ALONE)
    assert "Column 1" in page
    assert "of leg" not in page


def test_a_uniform_prior_counts_by_its_deviation(run):
    normal, _ = run(ALONE)
    half = 0.5 * np.sqrt(3.0)
    old = 's0 = { prior = "normal", sd = 0.5 }'
    uniform, _ = run((old, f's0 = {{ prior = "uniform", half_width = {half:.12f} }}'), ALONE)
    one, other = (take(results, "parameters")["posterior_sd"] for results in (uniform, normal))
    np.testing.assert_allclose(one, other, rtol=1e-6)


def test_nothing_required_is_a_statement_of_accuracy(run):
    bounds = ("x = 0.05, y = 0.05, z = 0.03", "z = [10.0, 30.0]")
    results, _ = run(("requirements = {", "workspace = {"), bounds, ALONE)
    assert "requirements" not in results.tables
    assert "[requirements]" in results.summary["headline"]


REFUSED = {
    "unknown coordinate": ("z = 0.03 }", "w = 0.03 }", "requirements: found 'w', expected one of x, y, z"),
    "limit of zero": ("z = 0.03 }", "z = 0.0 }", "requirements.z"),
    "count and file": ("count = 40", f"count = 40\n{POSES}", "poses: expected one of count, file"),
    "sensor without noise": ("height = { noise_um = 10.0 }", "", "found no noise of height"),
    "unknown sensor": ('"cam_y"]', '"cam_z"]', "variant 'camera': sensor 'cam_z': expected"),
    "variant twice": ('name = "probe"', 'name = "both"', "variants: found 'both' twice"),
    "too few candidates": ("candidates = 30", "candidates = 3", "found 3 candidates, expected at least 4"),
    "workspace beyond reach": ("[sensors]", "[workspace]\nx = [900.0, 901.0]\n[sensors]", "workspace: found few"),
    "profile of a symbol": ("seed = 4", 'seed = 4\nprofiles = ["l"]', "profile of 'l': fixed"),
    "draws of a posterior": ("[sensors]", "[posterior]\ndraws = 2000\n[sensors]", "posterior: expected [data]"),
    "a deformation": ("[sensors]", "[deformation]\nkappa = 0.1\n[sensors]", "deformation: expected a model"),
    "a unit of no file": ("count = 40", "count = 40\nunit_mm = 2.0", "unit_mm: expected configurations"),
    "no error to leave out": (
        "[sensors]",
        '[[scenarios]]\nname = "none"\nmodel_error = false\n[model_error]\nterms = ["random"]\n[sensors]',
        "scenario 'none': model_error: found none to leave out",
    ),
    "errors of a term that is not there": (
        "[sensors]",
        '[model_error]\nterms = ["positioning"]\nexpected_um = { drift = 1.0 }\n[sensors]',
        "expected_um: found ['drift'], expected one of ['positioning']",
    ),
    "given to a machine that needs nothing": (
        "[sensors]",
        "[conditions]\nt = [0.0, 1.0]\n[sensors]",
        "conditions: found 't'",
    ),
}
POSE_FILES = {
    "pose out of reach": (
        "pose,x_mm,y_mm,z_mm\nA,0,0,20\nB,900,0,20\n",
        "pose 'B': found no reading of s[1], expected",
    ),
    "unit of another kind": ("pose,x_deg,y_mm,z_mm\nA,0,0,20\n", "found column 'x_deg', did you mean"),
    "missing coordinate": ("pose,x_mm,y_mm\nA,0,0\n", "found no column 'z_mm'"),
    "coordinate twice": (
        "pose,x_mm,x_m,y_mm,z_mm\nA,0,0,0,20\n",
        "found columns 'x_mm' and 'x_m', expected one of them",
    ),
    "pose twice": ("pose,x_mm,y_mm,z_mm\nA,0,0,20\nA,0,0,20\n", "is already on line 2"),
    "no names": ("x_mm,y_mm,z_mm\n0,0,20\n", "found no column 'pose'"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_faulty_configs_are_one_line(case, folder, refuse):
    old, new, message = REFUSED[case]
    calibrations.change(folder / "audit.toml", old, new)
    refuse(re.escape(message), folder / "out", "run", folder / "audit.toml", "--quiet")


@pytest.mark.parametrize("case", POSE_FILES)
def test_faulty_poses_are_one_line(case, folder, refuse):
    content, message = POSE_FILES[case]
    (folder / "poses.csv").write_text(content)
    calibrations.change(folder / "audit.toml", "count = 40", POSES)
    refuse(re.escape(message), folder / "out", "run", folder / "audit.toml", "--quiet")


def test_units_of_a_file_are_taken_for_what_they_are(folder):
    (folder / "poses.csv").write_text("pose,x_m,y_mm,z_um\nA,0.05,1,20000\n")
    calibrations.change(folder / "audit.toml", "count = 40", POSES)
    inputs = read_design(load(folder / "audit.toml")[1], folder)
    np.testing.assert_allclose(inputs.plans["both"].variant.start, [[50.0, 1.0, 20.0]])


def test_the_terminal_says_the_verdict_and_every_set_of_sensors(folder, call, no_pictures):
    code, said, complaint = call("run", folder / "audit.toml", "--out", folder / "out", "--workers", 1)
    assert code == 0, complaint
    lines = said.splitlines()
    assert lines[1].startswith("Best of three sensor sets: “Camera and probe”")
    shown = [line.split()[1] for line in lines if re.match(r"\S (both|camera|probe) ", line)]
    assert shown == ["both", "camera", "probe"]
