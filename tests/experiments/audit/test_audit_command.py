"""The audit as its users meet it: exit codes, one line on standard error, everything written or nothing."""

from __future__ import annotations

import json

import audit_problems as problems
import pytest
import studies

from bayescal.experiments.audit import compute as audit_compute

SMALL = """
extends = "base.toml"
n_simulated_calibrations = 2
n_prior_draws = 2
profiles = ["l[1]"]

[poses]
count = 12

[workspace]
poses = 20

[sweep]
noise = [1.0]
poses = [10, 12]
workspace = [1.0]

[[scenarios]]
name = "<b>twice</b>"
poses_factor = 2.0
"""


def write(folder, text, shipped="camera_hexapod"):
    """Return a design that extends a copy of a shipped one, whose files are named absolutely."""
    base = (problems.DESIGNS / f"{shipped}.toml").read_text()
    base = base.replace('"camera_hexapod_mechanism', f'"{problems.DESIGNS}/camera_hexapod_mechanism')
    (folder / "base.toml").write_text(base.replace('"../', f'"{problems.DESIGNS.parent}/'))
    path = folder / "design.toml"
    path.write_text(text)
    return path


@pytest.fixture
def design(tmp_path):
    return write(tmp_path, SMALL)


def test_an_audit_writes_results_and_report(call, design, tmp_path, no_pictures):
    out = tmp_path / "out"
    code, said, complaint = call("audit", design, "--out", out, "--workers", 1)
    assert (code, studies.list_errors(complaint)) == (0, [])
    summary = json.loads((out / "summary.json").read_text())
    assert summary["headline"] in " ".join(said.split())
    assert summary["simulated_calibrations"]["n"] == 2
    assert all("posterior_sd_over_draws" in values for values in summary["parameters"].values())
    named = ["<b>twice</b>", "12 poses chosen I-optimally"]
    assert [change["name"] for change in summary["scenarios"]] == named
    page = (out / "report.html").read_text()
    assert "<b>twice" not in page
    assert "&lt;b&gt;twice" in page
    provenance = json.loads((out / "provenance.json").read_text())
    assert provenance["config_sha256"] == summary["config_sha256"]
    assert set(provenance["files"]) == {f"{problems.DESIGNS}/camera_hexapod_mechanism.toml"}
    assert not list(tmp_path.glob("*.partial"))


CAMERA = {
    "unknown sensor": (
        '[[variants]]\nmodel = "six_ups"\nsensors = ["laser"]',
        r"sensor 'laser': expected one of rho\[1\]",
    ),
    "no tolerance": ('[parameters]\nl = { prior = "normal", sd = 0.0 }', "found 0.0, expected greater than"),
    "profile of nothing": ('profiles = ["q[1]"]', r"profile of 'q\[1\]': fixed"),
    "no poses": ("[poses]\ncount = 0", "poses.count: found 0"),
    "poses out of reach": (
        "[poses]\nrange_mm = 20.0",
        "expected -14.1 to 14.1",
    ),
    "workspace too wide": ("[workspace]\nposition_mm = [90.0, 0.0, 0.0]", "workspace: x = 90 mm"),
    "extends itself": ('extends = "design.toml"', "extends: found more than 8 configs"),
    "extends another folder's": ('extends = "../base.toml"', "expected a config in the same directory"),
}
TELESCOPE = {
    "unknown parameter": ('[parameters]\nq_x = { prior = "normal", sd = 1.0 }', "found 'q_x'.*one of a_x"),
    "unknown sensor in a what-if": (
        '[[scenarios]]\nname = "w"\nsensors = ["theodolite"]',
        "sensor 'theodolite': expected",
    ),
    "unknown kind of sensor": ('[sensors.new]\nkind = "sextant"', "found 'sextant', expected one of pose, targets"),
    "pose out of reach": (
        "[poses]\nunit_mm = 2.0",
        "poses: pose 'P001': found rho.1. at 12 mm, expected 8.7",
    ),
    "workspace out of reach": (
        "[workspace]\nposition_mm = [1.0, 1.0, 3.0]",
        "workspace: x = .*, z = .* mm, .*: found rho.1. at .* mm, expected 8.7",
    ),
    "a few targets on a line": (
        '[sensors.photogrammetry]\nkind = "targets"\nbase = { points_mm = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]] }',
        "sensors.photogrammetry.base: found 2 targets",
    ),
    "unknown model": ('[[variants]]\nmodel = "seven_pus"', "found 'seven_pus', did you mean"),
    "missing table": ('[poses]\nconfigurations = "nothing.csv"', "nothing.csv: no such file"),
    "unknown key": ("[workspace]\ndepth_mm = 3", "workspace.depth_mm: unknown key"),
    "no prior": ('[[variants]]\nmodel = "six_pus"\nfree = ["u_z"]', "found 'u_z'"),
    "unit": ('[units]\nlength = "inch"', "units.length: found 'inch', expected"),
    "poses that cannot be": (
        'machine = "far.toml"\n[poses]\nsampling = "file"\nconfigurations = "moves.csv"\nunit_mm = 1.0',
        "pose 'P002': found no pose at displacements 600, -600",
    ),
}
FAULTS = [("camera_hexapod", *one) for one in CAMERA.values()]
FAULTS += [("telescope_six_pus_none", *one) for one in TELESCOPE.values()]


@pytest.mark.parametrize(("shipped", "change", "message"), FAULTS, ids=[*CAMERA, *TELESCOPE])
def test_a_design_at_fault_is_one_line_and_nothing_is_written(refuse, tmp_path, shipped, change, message):
    mechanism = (studies.TELESCOPE / "mechanism.toml").read_text()
    (tmp_path / "far.toml").write_text(mechanism.replace("actuator_range_mm = 1.3", "actuator_range_mm = 900.0"))
    (tmp_path / "moves.csv").write_text("r1,r2,r3,r4,r5,r6\n0,0,0,0,0,0\n600,-600,600,-600,600,-600\n")
    text = change if change.startswith("extends") else f'extends = "base.toml"\n{change}\n'
    refuse(f"design.toml.*{message}", tmp_path / "out", "audit", write(tmp_path, text, shipped), "--workers", 1)


@pytest.mark.runs
def test_a_posterior_that_did_not_converge_is_exit_code_3(call, design, tmp_path, monkeypatch, no_pictures):
    design.write_text(SMALL.replace("n_simulated_calibrations = 2", "n_simulated_calibrations = 0"))
    studies.edit(design, "n_prior_draws = 2", "n_prior_draws = 0")
    compute_audit = audit_compute.compute_audit

    def compute(inputs, run):
        results = compute_audit(inputs, run)
        results.summary["posterior"] = {
            **{"origin": "made up", "n_draws": 8, "converged": False, "problems": ["R-hat 1.2"], "parameters": {}},
            **{"requirements": {}, "principal_angle_deg": None},
        }
        return results

    monkeypatch.setattr(audit_compute, "compute_audit", compute)
    code, said, complaint = call("audit", design, "--out", tmp_path / "out", "--workers", 1)
    assert (code, len(studies.list_errors(complaint))) == (3, 1)
    assert "not converged" in complaint
    assert "of 42 parameters" in said
    assert (tmp_path / "out" / "report.html").is_file()
