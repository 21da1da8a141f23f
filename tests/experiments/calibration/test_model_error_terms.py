"""The model error of studies of tables, in its terms: what silent ones have, what variants choose, what is refused."""

from __future__ import annotations

import calibrations
import numpy as np
import pandas as pd
import pytest
from refusals import line_of

from bayescal.density.calibration.model_error import LowRankGPTerm
from bayescal.experiments.runner.load import load
from bayescal.experiments.shared.readings import errors
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.experiments.study.readings import fit_variant

TERMS = ("tau", "sigma_linear", "sigma_positioning", "sigma_smooth", "sigma_drift")
NONE = "\n[model_error]\nterms = []\n"


def read(path):
    return StudyInputs.load(load(path)[1], path.parent)


def write(folder, section="", variant=""):
    """Write a delta's study with a section, nothing by default, and keys of its first variant."""
    path = calibrations.write_delta(folder)
    calibrations.change(path, NONE, section and f"\n[model_error]\n{section}\n")
    return calibrations.change(path, 'name = "all"\n', f'name = "all"\n{variant}\n')


def names_of(study, variant="all"):
    return study.variants[variant].posterior().errors.names


def test_a_silent_study_has_all_terms_by_which_its_carriages_err(tmp_path):
    study = read(write(tmp_path))
    assert names_of(study) == names_of(study, "one_rod") == TERMS
    variant = study.variants["all"]
    columns = variant.posterior().errors.columns(np.zeros((1, 5)), variant.data)
    assert np.abs(columns[..., :3, :]).sum(axis=(0, 1, 3)).all()
    assert not columns[..., 3:, :].any()  # of the instruments
    assert not study.missing
    assert not [line for line in study.outlook() if "model error" in line]


def test_variants_have_terms_of_their_own(tmp_path):
    study = read(write(tmp_path, variant='model_error = ["random", "drift"]\nnoise_known = true'))
    assert names_of(study) == ("tau", "sigma_drift")
    assert names_of(study, "one_rod") == TERMS
    study = read(write(tmp_path / "other", variant="model_error = []"))
    assert names_of(study) == ()


def test_scales_floors_and_tau_by_channel_are_those_of_the_section(tmp_path):
    section = (
        "random_scale_um = 3.0\nsystematic_scale_um = 7.0\nfloor_um = { positioning = 2.0 }\nseparate_by_leg = true"
    )
    section += '\nterms = ["random", "positioning"]'
    *taus, own = read(write(tmp_path, section)).variants["all"].posterior().errors.terms
    assert [one.names for one in taus] == [("tau[1]",), ("tau[2]",), ("tau[3]",)]
    assert [one.priors[0].scale for one in taus] == pytest.approx([0.003] * 3)
    assert own.priors[0].scale == pytest.approx(0.007)
    assert own.floor == pytest.approx(0.002)
    together = read(write(tmp_path / "other", "floor_um = 6.0")).variants["all"].posterior().errors.terms
    floors = [one.floor for one in together]
    assert floors == pytest.approx([0.0, *[0.006 / np.sqrt(3.0)] * 3, 0.0])


@pytest.mark.parametrize(("noise_um", "scales"), [(5.0, (0.01, 0.02)), (300.0, (0.3, 0.6))])
def test_a_coarse_machine_may_err_by_more_where_nothing_is_said(noise_um, scales, tmp_path):
    path = write(tmp_path)
    calibrations.change(path, "s = { noise_um = 5.0 }", f"s = {{ noise_um = {noise_um} }}")
    tau, *functions = read(path).variants["all"].posterior().errors.terms
    assert tau.priors[0].scale == pytest.approx(scales[0])
    assert [one.priors[0].scale for one in functions] == pytest.approx(4 * scales[1:])


def test_one_channel_has_all_terms(tmp_path):
    study = read(write(tmp_path, variant='sensors = ["s[1]", "cam_x", "cam_y", "height"]'))
    assert names_of(study) == TERMS
    assert not study.missing


def test_where_rows_may_be_outliers_functions_are_those_of_few_coefficients_and_that_is_said(tmp_path):
    study = read(write(tmp_path, variant="student_t_dof = 4.0"))
    assert names_of(study) == ("tau", "sigma_linear")
    assert names_of(study, "one_rod") == TERMS
    said = "variant 'all': the model error has no terms positioning, smooth, drift, as single rows may be outliers"
    assert said in study.missing
    assert any(said in line for line in study.outlook())


REFUSED = {
    "a term that there cannot be": (
        "",
        'student_t_dof = 4.0\nmodel_error = ["linear", "positioning"]',
        "variant 'all': model_error: found term 'positioning', but single rows may be outliers",
    ),
    "no channel of its own": (
        'terms = ["random"]',
        'sensors = ["cam_x", "cam_y", "height"]',
        "model_error: found term 'random',",
    ),
    "many coefficients beside outliers": (
        "",
        'student_t_dof = 4.0\nmodel_error = ["smooth"]',
        "variant 'all': model_error: found term 'smooth', but",
    ),
    "a floor beyond the tolerances": (
        "floor_um = { linear = 600.0 }",
        "",
        "model_error.floor_um: found 600 µm for 'linear', expected less than 500 µm",
    ),
    "beside errors by channel": (
        "s = { scale = 0.01 }",
        'model_error = ["linear"]',
        "model_error: found terms ['linear']",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused(case, tmp_path):
    section, variant, text = REFUSED[case]
    assert text in line_of(read, write(tmp_path, section, variant))


# --- what is found -------------------------------------------------------------------------------------------------


def err(path, size):
    """Let the carriages of a study's tables err by one another's travel, so many µm rms; return the errors, µm."""
    table = pd.read_csv(path.parent / "data" / "readings.csv", comment="#")
    travel = read(path).variants["all"].posterior().errors.terms[1].own.place.travel
    error = travel @ np.array([[0.3, 1.0, -0.6], [-0.8, 0.2, 0.7], [0.9, -0.5, 0.4]])
    error *= size / np.sqrt(np.mean(error[table["use"] == "calibration"] ** 2))
    table[["s_1_mm", "s_2_mm", "s_3_mm"]] += error / 1000.0
    table.to_csv(path.parent / "data" / "readings.csv", index=False)
    return table, error


@pytest.mark.runs
def test_a_coupling_is_found_in_size_place_and_course(tmp_path):
    path = write(tmp_path)
    table, error = err(path, 100.0)
    study = read(path)
    variant = study.variants["all"]
    tables = fit_variant(study, "all").tables
    sizes = tables["model_error"].set_index("term")
    assert list(sizes.index) == ["random", "linear", "positioning", "smooth", "drift", "systematic_total"]
    assert (sizes["q05"] <= sizes["median"]).all()
    assert (sizes["median"] <= sizes["q95"]).all()
    assert sizes["median"].drop("systematic_total").idxmax() == "linear"
    poses = tables["model_error_poses"]
    assert list(poses["member"][:3]) == ["s[1]", "s[2]", "s[3]"]
    assert list(poses["pose"][::3]) == list(variant.data.poses) == list(table["pose"])
    assert list(poses["use"][::3]) == list(table["use"])
    members = tables["model_error_members"]
    assert list(members["term"][:4]) == ["linear", "positioning", "smooth", "drift"]
    largest = members[members["term"] == "linear"].set_index("member")["rms"]
    expected = np.sqrt(np.mean(error[table["use"] == "calibration"] ** 2, axis=0))
    np.testing.assert_allclose(largest, expected, rtol=0.4)
    assert sizes["q05"]["systematic_total"] < 100.0 < sizes["q95"]["systematic_total"] < 150.0
    there = (poses["low"] <= error.ravel()) & (error.ravel() <= poses["high"])
    assert there.mean() > 0.8


@pytest.mark.runs
def test_tables_of_random_errors_alone_have_their_size(tmp_path):
    path = write(tmp_path, 'terms = ["random"]\nfloor_um = { random = 4.0 }\nseparate_by_leg = true')
    fit = fit_variant(read(path), "all")
    assert {name for name in fit.tables if "model_error" in name} == {"model_error"}
    (row,) = fit.tables["model_error"].to_dict("records")
    taus = [k for k, name in enumerate(fit.names) if name.startswith("tau[")]
    assert len(taus) == 3
    draws = fit.draws.reshape(-1, fit.draws.shape[-1])[:, taus]
    expected = 1000.0 * np.median(np.sqrt(np.mean(draws**2, axis=1) + 0.004**2))
    assert row["median"] == pytest.approx(expected, rel=0.05)
    assert row["q05"] >= 4.0


def test_of_more_rows_than_their_covariance_is_made_for_functions_are_of_few_columns(tmp_path, monkeypatch):
    path = write(tmp_path)
    for most, few in ((89, True), (90, False)):  # 30 rows of three equations
        monkeypatch.setattr(errors, "MOST_ROWS", most)
        tau, *functions = read(path).variants["all"].errors.terms
        assert not isinstance(tau, LowRankGPTerm)
        assert [isinstance(one, LowRankGPTerm) for one in functions] == [few] * 4
