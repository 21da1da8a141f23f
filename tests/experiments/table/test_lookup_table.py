"""Look-up tables: what actuators and pose do, its few terms, what to measure next, what is refused, the command."""

from __future__ import annotations

import json

import lookup_tables
import numpy as np
import pandas as pd
import pytest
import studies
from calibrations import change

from bayescal.errors import InputError
from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.results import Results
from bayescal.experiments.shared.slips import CORRECTED
from bayescal.experiments.table.compute import find_table, summarise, tabulate
from bayescal.experiments.table.inputs import differentiate_correction, plan_measurements, respond
from bayescal.experiments.table.page import build_page

pytestmark = pytest.mark.runs

DRAWS = 40
ACTUATORS = [f"q_{leg}_mm" for leg in range(1, 7)]
GIVEN = ["elevation_deg", "temperature_c"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("table")
    lookup_tables.write_small(folder)
    return folder


def read(path):
    kind, config = load(path)
    return kind.read(config, path.parent)


@pytest.fixture(scope="module")
def inputs(folder):
    return read(folder / "table.toml")


@pytest.fixture(scope="module")
def gaussian(inputs):
    """Return the posterior, its mode and draws of the Gaussian there."""
    posterior = inputs.variant.posterior().with_pose_guesses()
    mode = posterior.least_squares_start()
    covariance = np.linalg.inv(-posterior.gradient(mode)[1])
    white = np.random.default_rng(1).standard_normal((DRAWS, len(mode)))
    return posterior, mode, covariance, mode + white @ np.linalg.cholesky(covariance).T


@pytest.fixture(scope="module")
def found(inputs, gaussian):
    _, mode, _, draws = gaussian
    return find_table(inputs, draws, mode)


def test_the_platform_stays_with_the_correction_and_goes_by_the_offset_without(inputs, gaussian, found):
    """Both against the machine's own function, draw by draw."""
    posterior, _, _, draws = gaussian
    theta = posterior.theta(draws)[:, None]
    here = {name: value[None] for name, value in inputs.given_at(inputs.cells).items()}
    reference = {name: np.array(value) for name, value in inputs.reference.items()}
    held = inputs.actuators.read(theta, inputs.pose, reference)
    offset, correction = found.responses.offset, found.responses.correction
    np.testing.assert_allclose(inputs.actuators.read(theta, inputs.pose, here), held + correction, atol=1e-10)
    there = inputs.actuators.read(theta, inputs.pose + offset, here)
    np.testing.assert_allclose(there, np.broadcast_to(held, there.shape), atol=1e-9)
    assert np.abs(offset[..., :3]).max() > 0.05


def test_a_table_is_zero_at_its_reference_and_nowhere_else(folder):
    path = change(folder / "table.toml", "elevation_deg = 60.0\n", "elevation_deg = 45.0\n")
    path = change(path, "temperature_c = 10.0\n", "temperature_c = 20.0\n")
    at = read(path)
    change(path, "elevation_deg = 45.0\n", "elevation_deg = 60.0\n")
    change(path, "temperature_c = 20.0\n", "temperature_c = 10.0\n")
    drawn = respond(at, at.variant.posterior().sampling.start[None], at.cells)
    zero = [tuple(cell) == (45.0, 20.0) for cell in at.cells]
    assert sum(zero) == 1
    np.testing.assert_array_equal(drawn.correction[:, zero], 0.0)
    assert np.abs(drawn.correction[:, np.logical_not(zero)]).max(axis=-1).min() > 1e-3


def test_the_terms_are_the_table(inputs, found):
    """Statics at one pose is linear in sine and cosine, expansion nearly so in temperature."""
    elevation, temperature = np.deg2rad(inputs.cells[:, 0]), inputs.cells[:, 1]
    zero = np.deg2rad(60.0)
    basis = [np.sin(elevation) - np.sin(zero), np.cos(elevation) - np.cos(zero), temperature - 10.0]
    mean = found.responses.correction.mean(axis=0)
    left = np.abs(mean - np.stack(basis, axis=1) @ found.polynomial.mean).max(axis=0)
    np.testing.assert_allclose(left, found.polynomial.misfit, atol=1e-12)
    assert left.max() < 1e-4
    spread = np.stack(basis, axis=1) @ found.polynomial.mean
    assert np.abs(spread).max() > 0.05
    n = len(found.polynomial.misfit)
    one = np.kron(np.stack(basis, axis=1)[0], np.eye(n))
    np.testing.assert_allclose(
        np.sqrt(np.diagonal(one @ found.polynomial.covariance @ one.T)),
        found.responses.correction[:, 0].std(axis=0, ddof=1),
        rtol=0.02,
    )


def test_the_derivative_of_corrections_is_that_of_differences(inputs, gaussian):
    posterior, mode, _, _ = gaussian
    exact = differentiate_correction(inputs, posterior.theta(mode[None])[0], posterior.around(mode)[1].T)
    step = 1e-4 * np.eye(len(mode))
    both = (respond(inputs, posterior.theta(mode + sign * step), inputs.cells).correction for sign in (1.0, -1.0))
    above, below = both
    np.testing.assert_allclose(np.moveaxis(above - below, 0, -1) / 2e-4, exact, atol=1e-9)


def test_the_first_measurement_is_the_best_of_all_candidates(inputs, gaussian, found):
    """Each candidate's posterior covariance from its readings, poses as parameters without a prior."""
    posterior, mode, covariance, _ = gaussian
    plan = plan_measurements(inputs, posterior, mode, covariance)
    theta = posterior.theta(mode[None])[0]
    flat = differentiate_correction(inputs, theta, posterior.around(mode)[1].T).reshape(-1, len(mode))
    rng, poses = np.random.default_rng([inputs.config.seed, 21]), inputs.config.plan.poses
    cell = np.repeat(inputs.cells, poses, axis=0)
    pose = inputs.variant.workspace.draw(len(cell), rng)
    sd = inputs.variant.data.sd[0]
    here = inputs.variant.model.linearise(theta, pose, True, inputs.given_at(cell))
    left = []
    for slope, by in zip(here.by_pose, here.by_parameters, strict=True):
        rows = np.concatenate([by @ posterior.around(mode)[1].T.T, slope], axis=1) / sd[:, None]
        information = rows.T @ rows
        information[: len(mode), : len(mode)] += np.linalg.inv(covariance)
        after = np.linalg.inv(information)[: len(mode), : len(mode)]
        left.append(np.sqrt(np.mean(np.einsum("si,ij,sj->s", flat, after, flat))))
    best = int(np.argmin(left))
    np.testing.assert_array_equal(plan.cell[0], cell[best])
    np.testing.assert_allclose(plan.after[0], left[best], rtol=1e-4)
    assert (np.diff([plan.before, *plan.after]) < 0.0).all()
    assert plan.after[0] <= plan.random[0]
    assert plan.before < plan.prior


def test_tables_and_page_say_what_was_found(inputs, found):
    tables, summary = tabulate(inputs, found), summarise(inputs, found, ["too few draws"])
    mean = found.responses.correction.mean(axis=0)
    np.testing.assert_allclose(tables["lookup"].filter(like="q_").to_numpy(), mean)
    rows = tables["correction_covariance"]
    first = rows[(rows["first"] == "q[2]") & (rows["second"] == "q[5]")]["covariance"].to_numpy()
    drawn = found.responses.correction
    expected = [np.cov(drawn[:, g, 1], drawn[:, g, 4])[0, 1] for g in range(len(inputs.cells))]
    np.testing.assert_allclose(first, expected, rtol=1e-9)
    page = build_page(Results(summary, tables))
    assert (page.verdict[0].lead, page.verdict[0].level, page.verdict[0].value) == ("Convergence", "bad", 1)
    assert json.dumps(summary, allow_nan=False)


def refuse(path, old, new):
    """Return the line with which a changed config is refused; the config is put back."""
    text = path.read_text()
    try:
        change(path, old, new)
        with pytest.raises(InputError) as caught:
            read(path)
    finally:
        path.write_text(text)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture(scope="module")
def rail(tmp_path_factory):
    return lookup_tables.write_rail(tmp_path_factory.mktemp("rail"))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('study = "study.toml"', 'study = "table.toml"', "expected 'study'"),
        ("allow_unconverged = true", 'variant = "al"', "found 'al', expected one of all"),
        ("elevation_deg = [0.0, 45.0, 90.0]", "azimuth_deg = [0.0, 45.0]", "reference: found no azimuth_deg"),
        ("elevation_deg = [0.0, 45.0, 90.0]", "elevation_deg = [45.0, 0.0]", "found values that do not rise"),
        (", temperature_c = 10.0 }", " }", "reference: found no temperature_c"),
        ("allow_unconverged = true", "pose = { w = 3.0 }", "pose: found 'w', expected one of x"),
        (
            "temperature_c = 10.0 }",
            "temperature_c = 10.0, wind = 3.0 }",
            "found 'wind', expected one of elevation_deg",
        ),
    ],
)
def test_a_bad_table_is_refused(rail, old, new, words):
    assert words in refuse(rail, old, new)


def test_actuators_that_do_not_hold_the_platform_are_refused(rail):
    study, text = rail.parent / "study.toml", (rail.parent / "study.toml").read_text()
    try:
        change(study, 'title = "All" }', 'title = "All", sensors = ["x"] }')
        with pytest.raises(InputError, match=r"0 own readings.* 1\b"):
            read(rail)
    finally:
        study.write_text(text)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            "elevation_deg = [0.0, 45.0, 90.0]",
            "elevation_deg = [0.0, 0.8, 1.5]",
            "axes: elevation_deg: found none above",
        ),
        ("temperature_c = 10.0", "temperature_c = 283.0", "reference: pose 'elevation_deg = 60, temperature_c = 283'"),
    ],
)
def test_places_that_cannot_be_are_refused(folder, old, new, words):
    assert words in refuse(folder / "table.toml", old, new)


SLIPS = {
    "none": ([], lambda x: x, None),
    "exchanged": (["q_1_mm", "q_2_mm"], lambda x: x[:, ::-1], "readings of q[1] and q[2] seem to be exchanged"),
    "shifted": (ACTUATORS, lambda x: np.roll(x, 1, axis=0), "rows of q seem shifted by one"),
    "of another day": (GIVEN, lambda x: np.roll(x, 1, axis=0), "rows of all readings against elevation_deg and temp"),
}


@pytest.mark.parametrize(
    "slip", [pytest.param(one, marks=() if one in ("none", "exchanged") else pytest.mark.slow) for one in SLIPS]
)
def test_the_likely_cause_of_readings_far_off_is_said(slip, tmp_path):
    columns, mend, said = SLIPS[slip]
    path = lookup_tables.write_small(tmp_path, 12)
    data = tmp_path / "data" / "readings.csv"
    table = pd.read_csv(data, comment="#")
    table[columns] = mend(table[columns].to_numpy())
    table.to_csv(data, index=False)
    kind, config = load(path)
    doubts = kind.suspect(kind.read(config, tmp_path))
    assert len(doubts) == (said is not None)
    assert said is None or doubts[0].partition(CORRECTED)[2].startswith(said)


def test_rows_without_elevation_are_refused(folder):
    data = folder / "data" / "readings.csv"
    text = data.read_text()
    try:
        change(data, "elevation_deg", "elevation")
        change(folder / "study.toml", 'channels = ["q"', 'ignore = ["elevation"]\nchannels = ["q"')
        with pytest.raises(InputError, match="found no elevation_deg,"):
            read(folder / "table.toml")
    finally:
        data.write_text(text)
        change(folder / "study.toml", 'ignore = ["elevation"]\n', "")


def test_a_posterior_that_did_not_converge_makes_a_table_where_that_is_allowed(tmp_path, call, no_pictures):
    path = change(lookup_tables.write_rail(tmp_path), "allow_unconverged = true\n", "")
    change(tmp_path / "study.toml", "burn_in = 10, steps = 20", "burn_in = 0, steps = 4")
    arguments = ["table", path, "--out", tmp_path / "out", "--workers", 1, "--quiet"]
    code, _, err = call(*arguments)
    assert code == 3
    (line,) = studies.list_errors(err)
    assert "--allow-unconverged" in line
    assert not (tmp_path / "out").exists()
    assert call(*arguments, "--allow-unconverged")[0] == 0
    lookup = pd.read_csv(tmp_path / "out" / "lookup.csv")
    assert list(lookup.columns) == ["elevation_deg", "temperature_c", "q_mm"]
    # at the horizon and 20 °C less the zenith and 10 °C: the sag and ten times the growth
    row = lookup[(lookup["elevation_deg"] == 0.0) & (lookup["temperature_c"] == 20.0)]
    assert abs(row["q_mm"].item() - (0.05 + 10.0 * 0.004)) < 0.02
    terms = json.loads((tmp_path / "out" / "polynomial.json").read_text())
    assert len(terms["covariance"]) == len(terms["covariance_order"]) == 3
    assert "Not converged" in (tmp_path / "out" / "report.html").read_text()
