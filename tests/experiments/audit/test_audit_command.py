"""The audit as its users meet it: exit codes, one line on standard error, everything written or nothing."""

from __future__ import annotations

import json

import audit_problems as problems
import pytest
import studies

from bayescal.experiments.audit import kind as audit_kind

SMALL = """
extends = "base.toml"
simulated_calibrations = 4
expected_over_draws = 3
profiles = ["l[1]"]

[workspace]
poses = 20

[sweep]
noise = [1.0]
poses = [10, 40]
workspace = [1.0]

[[what_if]]
name = "<b>twice</b>"
poses_factor = 2.0
"""


@pytest.fixture
def design(tmp_path):
    """Return a design that extends a copy of the camera hexapod's."""
    shipped = (problems.DESIGNS / "camera_hexapod.toml").read_text()
    shipped = shipped.replace('"camera_hexapod_mechanism', f'"{problems.DESIGNS}/camera_hexapod_mechanism')
    (tmp_path / "base.toml").write_text(shipped)
    path = tmp_path / "design.toml"
    path.write_text(SMALL)
    return path


def test_an_audit_writes_results_and_report(call, design, tmp_path, no_pictures):
    out = tmp_path / "out"
    code, said, complaint = call("audit", design, "--out", out, "--workers", 1)
    assert (code, studies.list_errors(complaint)) == (0, [])
    assert "Of 42 parameters" in said
    summary = json.loads((out / "summary.json").read_text())
    assert summary["simulated_calibrations"]["n"] == 4
    assert all("posterior_sd_over_draws" in values for values in summary["parameters"].values())
    named = ["<b>twice</b>", "40 poses chosen I-optimally"]
    assert [change["name"] for change in summary["what_if"]] == named
    page = (out / "report.html").read_text()
    assert "<b>twice" not in page
    assert "&lt;b&gt;twice" in page
    provenance = json.loads((out / "provenance.json").read_text())
    assert provenance["config_sha256"] == summary["config_sha256"]
    assert set(provenance["files"]) == {f"{problems.DESIGNS}/camera_hexapod_mechanism.toml"}
    assert not list(tmp_path.glob("*.partial"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            '[[variants]]\nmodel = "six_ups"\nsensors = ["laser"]',
            "sensor 'laser': unknown here, expected some of rho[1]",
        ),
        ('[parameters]\nl = { prior = "normal", sd = 0.0 }', "found 0.0, expected greater than"),
        ('profiles = ["q[1]"]', "profile of 'q[1]': not free here"),
        ("[poses]\ncount = 0", "poses.count: found 0"),
        ("[poses]\nrange_mm = 20.0", "expected it within the actuators' range, -14.1 to 14.1"),
        ("[workspace]\nposition_mm = [90.0, 0.0, 0.0]", "workspace: x = 90 mm"),
    ],
)
def test_a_design_at_fault_is_one_line_and_nothing_is_written(call, design, tmp_path, change, message):
    design.write_text(f'extends = "base.toml"\n{change}\n')
    code, said, complaint = call("audit", design, "--out", tmp_path / "out", "--workers", 1)
    assert (code, said, complaint.count("\n")) == (2, "", 1)
    assert message in complaint
    assert "design.toml" in complaint
    assert not (tmp_path / "out").exists()


def test_a_posterior_that_did_not_converge_is_exit_code_3(call, design, tmp_path, monkeypatch, no_pictures):
    design.write_text(SMALL.replace("simulated_calibrations = 4", "simulated_calibrations = 0"))
    studies.edit(design, "expected_over_draws = 3", "expected_over_draws = 0")
    compute_audit = audit_kind.compute_audit

    def compute(inputs, run):
        results = compute_audit(inputs, run)
        results.summary["posterior"] = {
            **{"origin": "made up", "n_draws": 8, "converged": False, "problems": ["R-hat 1.2"], "parameters": {}},
            **{"requirements": {}, "principal_angle_deg": None},
        }
        return results

    monkeypatch.setattr(audit_kind, "compute_audit", compute)
    code, said, complaint = call("audit", design, "--out", tmp_path / "out", "--workers", 1)
    assert (code, len(studies.list_errors(complaint))) == (3, 1)
    assert "did not converge" in complaint
    assert "Of 42 parameters" in said
    assert (tmp_path / "out" / "report.html").is_file()
