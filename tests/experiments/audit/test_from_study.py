"""A study's measurements as an audit takes them: machine, tolerances, poses, noise and posterior are the study's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import studies

from bayescal.errors import InputError
from bayescal.experiments.audit.audit import analyse, run_audit
from bayescal.experiments.audit.design import load_audit, read_inputs
from bayescal.experiments.audit.kind import Audit
from bayescal.experiments.frame.identity import hash_identity, identify
from bayescal.experiments.frame.parallel import Run
from bayescal.inference.mode import find_modes
from bayescal.machines.kinematics import solve_forward_kinematics

DESIGN = """
kind = "audit"
name = "audit_tiny"
title = "Tiny audit"
seed = 5

[data]
study = "tiny/study.toml"

[[variants]]
model = "six_pus"
deformation = "matrix"

[posterior]
draws = 2000
walkers = 32

[workspace]
position_mm = [0.5, 0.5, 0.05]
rotation_deg = [0.2, 0.2, 0.0]
poses = 20

[requirements]
z = 0.02
"""


@pytest.fixture
def design(tmp_path):
    """Return the path of a design beside a tiny study."""
    studies.write_tiny_study(tmp_path / "tiny")
    (tmp_path / "design.toml").write_text(DESIGN)
    return tmp_path / "design.toml"


def _read(path):
    return read_inputs(load_audit(path), path.parent)


def test_machine_tolerances_and_poses_are_the_studys(design):
    inputs, study = _read(design), studies.load_study(design.parent / "tiny" / "study.toml")
    knowledge, plan, poses = inputs.knowledge, inputs.plan, study.poses(verification=False)
    assert set(knowledge.symbols) == {"l", "kappa"}
    expected = {"l": 2.0, "kappa": 0.01}
    assert np.array_equal(knowledge.sd, [expected[symbol] for symbol in knowledge.symbols])
    assert plan.n_poses == studies.N_CALIBRATION
    assert np.array_equal(plan.actuators, poses.actuators)
    unit = plan.information(
        solve_forward_kinematics(knowledge.machine, knowledge.machine.layout.nominal, plan.actuators)
    )
    assert np.allclose(unit @ poses.covariance, np.eye(6), atol=1e-8)
    assert plan.actuator_noise == 1e-3
    assert knowledge.machine.mechanism.name == study.mechanism.name


def test_derivatives_are_taken_at_the_posterior_mean(design):
    inputs = _read(design)
    draws = inputs.measured.draws
    assert len(draws.values) >= 2000
    knowledge = inputs.knowledge
    assert np.array_equal(knowledge.centre[knowledge.free], draws.values.mean(axis=0))
    offset = knowledge.centre - knowledge.layout.nominal
    assert np.abs(offset[knowledge.free]).max() > 0.1  # the twin's legs are off by up to a millimetre
    held = np.setdiff1d(np.arange(offset.size), knowledge.free)
    assert not offset[held].any()


def test_noise_is_that_of_model_error_and_measured_matrix(design):
    inputs, study = _read(design), studies.load_study(design.parent / "tiny" / "study.toml")
    variant = study.variant("six_pus/matrix")
    left = study.matrix_variance(variant, verification=False).mean()
    n = inputs.measured.posterior.n_geometry
    tau = inputs.measured.draws.natural[..., n:]
    assert np.isclose(inputs.plan.model_error**2, np.mean(tau**2) + left, rtol=1e-12)
    studies.edit(design, 'study = "tiny/study.toml"', 'study = "tiny/study.toml"\nwith_model_error = false')
    assert np.isclose(_read(design).plan.model_error ** 2, left, rtol=1e-12)


def test_without_draws_the_mode_stands_in(design):
    studies.edit(design, "draws = 2000", "draws = 0")
    inputs = _read(design)
    assert inputs.measured.draws is None
    posterior = inputs.measured.posterior
    mode = posterior.natural(find_modes(posterior)[0].y[None])[0]
    knowledge = inputs.knowledge
    assert np.array_equal(knowledge.centre[knowledge.free], mode[: posterior.n_geometry])


def test_values_that_a_study_fixes_are_fixed(design):
    study = design.parent / "tiny" / "study.toml"
    studies.edit(study, "offset = 0.0", "offset = 0.25")
    knowledge = _read(design).knowledge
    places = knowledge.layout.index["b_z"]
    assert np.array_equal(knowledge.centre[places], knowledge.layout.nominal[places] + 0.25)


def test_files_of_the_study_are_the_audits(design):
    """Whatever changes the study's posterior changes the audit's identity."""
    config = load_audit(design)
    names = Audit().files(config, design.parent)
    data = {f"tiny/{name}" for name in ("mechanism.toml", "published.csv", *studies.tiny_survey_texts())}
    assert set(names) == {"tiny/study.toml", *data}
    before = hash_identity(identify(config, design.parent, names))
    for name in names:
        path = design.parent / name
        text = path.read_text()
        path.write_text(f"{text}\n")
        assert hash_identity(identify(config, design.parent, names)) != before, name
        path.write_text(text)
    assert hash_identity(identify(config, design.parent, names)) == before


def test_audit_of_a_study_runs_with_its_what_ifs(design):
    audit = run_audit(_read(design), Run())
    assert audit.analysis.structure.rank == 12
    assert all(outcome.information is not None for outcome in audit.what_ifs)
    assert 0.0 < audit.outlooks[0].predicted_sd < audit.outlooks[0].prior_sd


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('deformation = "matrix"', 'deformation = "linear"', "found no six_pus/linear, expected one of six_pus/none"),
        ("[[variants]]", '[[variants]]\nfree = ["l"]', "variants.free: found l, expected none or those of the study's"),
        ("seed = 5", 'seed = 5\nmachine = "other.toml"', "other.toml beside [data], expected none or the study's"),
        ("seed = 5", "seed = 5\nposes = { count = 9 }", "found poses beside [data], expected none"),
        ("[data]", "[noise]\nactuator_um = 1.0\n[data]", "found noise beside [data], expected none"),
        ("tiny/study.toml", "tiny/nowhere.toml", "nowhere.toml"),
        ("tiny/study.toml", "simulate.toml", "kind: found 'simulation', expected 'study'"),
    ],
)
def test_designs_at_fault_are_told_in_one_line(old, new, said, design):
    other = studies.TELESCOPE / "simulate.toml"
    (design.parent / "simulate.toml").write_text(other.read_text())
    studies.edit(design, old, new)
    with pytest.raises(InputError) as caught:
        _read(design)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_outliers_are_refused(design):
    study = design.parent / "tiny" / "study.toml"
    study.write_text(study.read_text().replace("[[variants]]", "[[variants]]\noutlier_share = 0.02"))
    with pytest.raises(InputError, match="found outlier_share, expected none") as caught:
        _read(design)
    assert "\n" not in str(caught.value)


def test_errors_that_are_functions_of_the_pose_come_from_the_posterior(design):
    study = design.parent / "tiny" / "study.toml"
    studies.edit(study, 'terms = ["independent"]', 'terms = ["independent", "smooth"]')
    studies.edit(study, 'deformation = "matrix"\nfree = ["l", "kappa"]', 'deformation = "linear"\nfree = ["l"]')
    studies.edit(design, 'deformation = "matrix"', 'deformation = "linear"')
    inputs = _read(design)
    draws, posterior = inputs.measured.draws.natural.reshape(-1, inputs.measured.posterior.n_parameters), None
    posterior = inputs.measured.posterior
    scale = draws[:, posterior.names.index("sigma_smooth")]
    assert inputs.plan.systematic.sizes == pytest.approx({"smooth": np.sqrt(np.mean(scale**2))})
    tau = draws[:, posterior.names.index("tau")]
    assert inputs.plan.model_error == pytest.approx(np.sqrt(np.mean(tau**2)))
    found = analyse(inputs).information
    alone = analyse(replace(inputs, plan=replace(inputs.plan, systematic=None))).information
    assert (found.contraction < alone.contraction).all()
    # foretold as the draws have it: the same machine, the same noise
    left = draws[:, : posterior.n_geometry].std(axis=0) / inputs.knowledge.sd
    assert np.abs(np.sqrt(1.0 - found.contraction) / left - 1.0).max() < 0.15


def test_the_studys_own_mechanism_may_be_named(design):
    studies.edit(design, "seed = 5", 'seed = 5\nmachine = "tiny/../tiny/mechanism.toml"')
    assert _read(design).plan.n_poses == studies.N_CALIBRATION
