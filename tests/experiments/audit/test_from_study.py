"""A study's measurements as an audit takes them: machine, tolerances, poses, noise and posterior are the study's."""

from __future__ import annotations

import calibrations
import numpy as np
import pytest
import studies
from refusals import line_of

from bayescal.experiments.audit.audit import analyse, run_audit
from bayescal.experiments.audit.design import draw_plan, load_audit, read_design
from bayescal.experiments.audit.kind import Audit
from bayescal.experiments.runner.identity import hash_identity, identify
from bayescal.experiments.runner.parallel import Run
from bayescal.inference.mode import find_modes

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


def _write(folder):
    """Write a design beside a tiny study and return its path."""
    studies.write_tiny_study(folder / "tiny")
    (folder / "design.toml").write_text(DESIGN)
    return folder / "design.toml"


@pytest.fixture
def design(tmp_path):
    return _write(tmp_path)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return plan and draws of the design as it is, and its study."""
    path = _write(tmp_path_factory.mktemp("whole"))
    return *_draw(path), studies.load_study(path.parent / "tiny" / "study.toml")


def _read(path):
    return _draw(path)[0]


def _draw(path):
    """Return the plan of a design and the draws of its study's posterior."""
    return draw_plan(read_design(load_audit(path), path.parent), Run())


def test_machine_tolerances_and_poses_are_the_studys(whole):
    plan, _, study = whole
    poses, data, model = study.measured[0].poses.select(~study.verification), plan.variant.data, plan.variant.model
    assert set(plan.symbols) == {"l", "kappa"}
    expected = {"l": 2.0, "kappa": 0.01}
    assert np.allclose(plan.sd, [expected[symbol] for symbol in plan.symbols])
    assert plan.n_poses == studies.N_CALIBRATION
    assert np.abs(plan.variant.start[:, :3] - poses.position).max() < 0.02
    seen = np.array([one.external for one in model.channels])
    covariance = data.correlation * data.sd[:, :, None] * data.sd[:, None]
    assert np.allclose(covariance[:, seen][:, :, seen], poses.covariance, rtol=1e-9, atol=1e-18)
    assert plan.maker.model.name == study.pads.mechanism.name


def test_derivatives_are_taken_at_the_posterior_mean(whole):
    plan, draws, _ = whole
    assert len(draws.values) >= 2000
    assert np.allclose(plan.parameters.nominal, draws.values.mean(axis=0), rtol=1e-12)
    start, layout = plan.posterior.sampling.start, plan.variant.model.layout
    offset, free = start - layout.nominal, plan.posterior.sampling.free
    assert np.abs(offset[free]).max() > 0.1  # the twin's legs are off by up to a millimetre
    assert not np.delete(offset, free).any()


def test_noise_is_that_of_model_error_and_measured_matrix(design, whole):
    plan, draws, study = whole
    own, n = plan.variant.internal, study.pads.mechanism.n_legs
    travel = study.pads.displacement[~study.verification]
    by_entry = np.einsum("ij,pk->pijk", np.eye(n), travel) * ~np.eye(n, dtype=bool)
    by_entry = by_entry.reshape(len(travel), n, n * n)
    left = np.einsum("pia,ab,pib->pi", by_entry, study.pads.pads.matrix.covariance, by_entry)
    # but for how far legs lean, which deflections along the platform's normal do not
    assert np.allclose(plan.variant.data.sd[:, own] ** 2, 1e-6 + left, rtol=0.06, atol=1e-9)
    tau = plan.maker.found.posterior.errors.natural(draws.zeta)
    assert tau.shape[1] == 1
    assert np.isclose(plan.tau**2, np.mean(tau**2), rtol=1e-9)
    studies.edit(design, 'study = "tiny/study.toml"', 'study = "tiny/study.toml"\nwith_model_error = false')
    assert _read(design).tau == 0.0


def test_without_draws_the_mode_stands_in(design):
    studies.edit(design, "draws = 2000", "draws = 0")
    plan, draws = _draw(design)
    assert draws is None
    posterior = plan.maker.found.with_pose_guesses
    mode = posterior.natural(find_modes(posterior)[0].y[None])[0]
    assert np.allclose(plan.parameters.nominal, mode[: posterior.n_geometry], rtol=1e-12)


def test_values_that_a_study_fixes_are_fixed(design):
    study = design.parent / "tiny" / "study.toml"
    studies.edit(study, "offset = 0.0", "offset = 0.25")
    plan = _read(design)
    layout = plan.variant.model.layout
    places = layout.index["b_z"]
    assert np.array_equal(plan.posterior.sampling.start[places], layout.nominal[places] + 0.25)


def test_files_of_the_study_are_the_audits(design):
    """Whatever changes the study's posterior changes the audit's identity."""
    config = load_audit(design)
    names = Audit().files(config, design.parent)
    data = {f"tiny/{name}" for name in ("mechanism.toml", *studies.tiny_survey_texts())}
    assert set(names) == {"tiny/study.toml", *data}
    before = hash_identity(identify(config, design.parent, names))
    for name in names:
        path = design.parent / name
        text = path.read_text()
        path.write_text(f"{text}\n")
        assert hash_identity(identify(config, design.parent, names)) != before, name
        path.write_text(text)
    assert hash_identity(identify(config, design.parent, names)) == before


def test_audit_of_a_study_runs_with_its_what_ifs(whole):
    audit = run_audit(whole[0], Run())
    assert audit.analysis.structure.rank == 12
    assert all(outcome.information is not None for outcome in audit.scenarios)
    assert 0.0 < audit.outlooks[0].predicted_sd < audit.outlooks[0].prior_sd


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('deformation = "matrix"', 'deformation = "linear"', "found no six_pus/linear, expected one of six_pus/none"),
        ("[[variants]]", '[[variants]]\nfree = ["l"]', "variants.free: found with [data]"),
        ("seed = 5", 'seed = 5\nmachine = "other.toml"', "found machine with [data]"),
        (
            "seed = 5",
            'seed = 5\nscenarios = [{ name = "w", sensors = ["rho"] }]',
            "scenario 'w': sensors: found with [data]",
        ),
        ("seed = 5", "seed = 5\nposes = { count = 9 }", "found poses with [data]"),
        ("[data]", "[noise]\nactuator_um = 1.0\n[data]", "found sensors with [data]"),
        ("tiny/study.toml", "tiny/nowhere.toml", "nowhere.toml"),
        ("tiny/study.toml", "simulate.toml", "kind: found 'simulation', expected 'study'"),
    ],
)
def test_designs_at_fault_are_told_in_one_line(old, new, said, design):
    other = studies.TELESCOPE / "simulate.toml"
    (design.parent / "simulate.toml").write_text(other.read_text())
    studies.edit(design, old, new)
    assert said in line_of(_read, design)


def test_outliers_are_refused(design):
    study = design.parent / "tiny" / "study.toml"
    study.write_text(study.read_text().replace("[[variants]]", "[[variants]]\noutlier_fraction = 0.02"))
    assert "found outlier_fraction," in line_of(_read, design)


def test_errors_that_are_functions_of_the_pose_come_from_the_posterior(design):
    study = design.parent / "tiny" / "study.toml"
    studies.edit(study, 'terms = ["random"]', 'terms = ["random", "smooth"]')
    studies.edit(study, 'deformation = "matrix"\nfree = ["l", "kappa"]', 'deformation = "linear"\nfree = ["l"]')
    studies.edit(design, 'deformation = "matrix"', 'deformation = "linear"')
    plan, draws = _draw(design)
    errors = plan.maker.found.posterior.errors
    natural = dict(zip(errors.names, errors.natural(draws.zeta).T, strict=True))
    assert plan.sizes == pytest.approx({"smooth": np.sqrt(np.mean(natural["sigma_smooth"] ** 2))})
    assert plan.tau == pytest.approx(np.sqrt(np.mean(natural["tau"] ** 2)))
    found, alone = analyse(plan).information, analyse(plan.without_systematic_errors()).information
    assert (found.contraction < alone.contraction).all()
    # foretold as the draws have it: the same machine, the same noise
    left = draws.values.std(axis=0) / plan.sd
    assert np.abs(np.sqrt(1.0 - found.contraction) / left - 1.0).max() < 0.2


def test_data_by_tables_are_audited_like_poses_of_an_instrument(tmp_path):
    """A linear delta's readings: what is left of tolerances by first order is what the study's draws leave."""
    folder = calibrations.write_audit(tmp_path).parent
    text = DESIGN.replace('tiny/study.toml"', 'study.toml"\nvariant = "all"').replace("audit_tiny", "audit_delta")
    a, b = text.index("[[variants]]"), text.index("[posterior]")
    c, d = text.index("[workspace]"), text.index("[requirements]")
    (folder / "design.toml").write_text(text[:a] + text[b:c] + text[d:])
    plan, draws = _draw(folder / "design.toml")
    assert set(plan.symbols) == {"x", "y", "l", "s0", "t_x", "t_y"}
    left = draws.values.std(axis=0) / plan.sd
    found = np.sqrt(1.0 - plan.inform().contraction)
    assert np.abs(found / left - 1.0).max() < 0.2
    audit = run_audit(plan, Run())
    assert 0.0 < audit.outlooks[0].predicted_sd < audit.outlooks[0].prior_sd
