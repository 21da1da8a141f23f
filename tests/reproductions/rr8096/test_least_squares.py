"""Least squares as in RR-8096 section 7: its tables come back from the twin of table 7 (a)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import studies
from papers import claims

from bayescal.files.csv_tables import read_table
from bayescal.machines.readings.legs import legs_of
from rr8096.identified import identify_variants, list_free, tabulate_least_squares
from rr8096.least_squares import identify, list_identified, minimise

assert claims  # once it is loaded `rr8096` can be imported
LEGS = [f"leg{k}" for k in range(1, 7)]
POINTS = ("a_x", "a_y", "b_x", "b_y")
LENGTHS = (*POINTS, "l")
INITIAL_POSITION = 10.0
EVERYTHING = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l", "rho0")


def read_published(name: str) -> dict[str, np.ndarray]:
    """Return the offsets of a published table by symbol; mm, dimensionless."""
    table = read_table(studies.TELESCOPE / "published" / f"{name}.csv", ("parameter", "unit", *LEGS))
    factor = {"mm": 1.0, "1": 1.0, "1e-3": 1e-3}
    values = table.numbers(LEGS)
    return {
        symbol: values[row] * factor[unit]
        for row, (symbol, unit) in enumerate(zip(table.text("parameter"), table.text("unit"), strict=True))
    }


class Study:
    """The telescope's study, and what least squares identifies of its variants."""

    def __init__(self):
        self.inputs = studies.load_study(studies.TELESCOPE / "study.toml")
        measured = self.inputs.seen.measured
        self.poses = measured.poses.select(~measured.verification)
        self.fits = identify_variants(self.inputs)

    def machine(self, name):
        return legs_of(self.inputs.variants[name].whole).machine

    def free(self, name):
        return list_free(self.inputs.variants[name])

    def find(self, name, fit=None):
        """Return the offsets from nominal by symbol."""
        layout, fit = self.machine(name).layout, fit or self.fits[name]
        return {symbol: layout.take(fit.theta - layout.nominal, symbol) for symbol in self.free(name)}


@pytest.fixture(scope="module")
def study():
    return Study()


def join(offsets: dict[str, np.ndarray], symbols=LENGTHS) -> np.ndarray:
    return np.concatenate([offsets[symbol] for symbol in symbols])


def rms_of_lengths(found: dict[str, np.ndarray], published: dict[str, np.ndarray]) -> float:
    return float(np.sqrt(np.mean((join(found) - join(published)) ** 2)))


@pytest.mark.parametrize(
    ("variant", "table"),
    [("six_pus/none", "table5a"), ("six_pus/linear", "table6a"), ("beam/none", "table5c"), ("beam/linear", "table6c")],
)
def test_published_lengths_come_back(study, variant, table):
    assert study.fits[variant].converged
    assert rms_of_lengths(study.find(variant), read_published(table)) < 0.35
    assert rms_of_lengths(study.find(variant), read_published("table7a")) > 0.35


def test_published_directions_come_back_and_move_the_attachment_to_keep_the_home_joint(study):
    none, linear, published = study.find("six_pus/none"), study.find("six_pus/linear"), read_published("table5a")
    np.testing.assert_allclose(none["u_x"], published["u_x"], atol=0.03, rtol=0)
    np.testing.assert_allclose(none["a_x"] - linear["a_x"], -INITIAL_POSITION * none["u_x"], atol=0.1)


def test_truth_of_the_twin_comes_back_where_the_model_is_right(study):
    truth = read_published("table7a")
    for variant in ("six_pus/matrix", "beam/matrix", "stiffness/matrix"):
        found, fit = study.find(variant), study.fits[variant]
        assert rms_of_lengths(found, truth) < 0.15
        np.testing.assert_allclose(found["kappa"], truth["kappa"], atol=1e-3)
        assert fit.residual_rms.max() < 5e-3
        assert study.fits[variant.replace("matrix", "none")].residual_rms.min() > 2 * fit.residual_rms.max()


@pytest.mark.parametrize(("deformation", "table"), [("none", "5"), ("linear", "6")])
def test_objective_in_newtons_moves_the_points_as_published(study, deformation, table):
    """Tables (d) minus tables (a): the pattern comes with the objective, not with the model."""
    name = f"stiffness/{deformation}"
    in_lengths = identify(study.machine(name), study.poses, tuple(study.free(name)), objective=np.eye(6))
    base = join(study.find(f"six_pus/{deformation}"), POINTS)
    published = join(read_published(f"table{table}d"), POINTS)
    moved = published - join(read_published(f"table{table}a"), POINTS)
    newtons, lengths = (join(study.find(name, fit), POINTS) for fit in (None, in_lengths))
    assert np.corrcoef(newtons - base, moved)[0, 1] > 0.7
    assert np.corrcoef(lengths - base, moved)[0, 1] < 0.0
    assert np.mean((newtons - published) ** 2) < np.mean((lengths - published) ** 2)


def compute_gradient(machine, poses, theta, free, weight) -> np.ndarray:
    """Return the gradient of the sum of squares in units of its terms' size: cosines of residual and columns."""
    here = machine.linearise(theta, poses.position, poses.rotation, poses.actuators)
    residual = (here.residual @ weight.T).ravel()
    jacobian = (weight @ here.parameters[..., free]).reshape(len(residual), -1)
    return jacobian.T @ residual / (np.linalg.norm(jacobian, axis=0) * np.linalg.norm(residual))


@pytest.mark.parametrize("variant", ["six_pus/linear", "jacobian/none", "stiffness/linear"])
def test_the_models_own_objective_is_at_its_minimum(study, variant):
    machine, fit, poses = study.machine(variant), study.fits[variant], study.poses
    free = np.concatenate([machine.layout.index[s] for s in study.free(variant)])
    weight = machine.model.objective(machine.mechanism)
    assert np.abs(compute_gradient(machine, poses, fit.theta, free, weight)).max() < 1e-5
    residual = machine.linearise(fit.theta, poses.position, poses.rotation, poses.actuators).residual
    assert fit.objective == pytest.approx(np.sum((residual @ weight.T) ** 2), rel=1e-9)
    np.testing.assert_allclose(fit.residual_rms, np.sqrt(np.mean(residual**2, axis=0)), rtol=1e-9)
    away = fit.theta + 1e-3 * np.isin(np.arange(machine.layout.size), free)
    assert np.abs(compute_gradient(machine, poses, away, free, weight)).max() > 1e-4
    in_lengths = np.abs(compute_gradient(machine, poses, fit.theta, free, np.eye(6))).max()
    assert (in_lengths > 0.1) == variant.startswith("stiffness")  # newtons and lengths have minima of their own


def test_start_does_not_matter(study, rng):
    """Even where a direction starts on its leg's slope, at which nothing depends on it."""
    name = "six_pus/none"
    machine, best = study.machine(name), study.fits[name]
    layout = machine.layout
    free = np.concatenate([layout.index[s] for s in study.free(name)])
    for slope in (-0.0571, 0.0571, 0.3):
        start = layout.nominal.copy()
        start[free] += rng.standard_normal(len(free))
        start[layout.index["u_x"]] = slope
        fit = identify(machine, study.poses, tuple(study.free(name)), start)
        np.testing.assert_allclose(fit.theta, best.theta, atol=1e-5)
    start = best.theta.copy()
    start[layout.index["u_x"][0]] = 0.5
    other = minimise(machine, study.poses, free, start, np.eye(6))  # one descent alone ends on the mirrored side
    assert other.converged
    assert other.theta[layout.index["u_x"][0]] > 0.4
    assert other.objective > 1.001 * best.objective


@pytest.mark.parametrize("model", ["six_pus", "jacobian", "beam", "stiffness"])
def test_with_everything_free_six_directions_per_leg_are_identified(study, model):
    machine = study.machine(f"{model}/none")
    fit = identify(machine, study.poses, tuple(block.symbol for block in machine.layout.blocks))
    assert fit.converged
    assert fit.n_identified == 36
    known = np.concatenate([machine.layout.index[s] for s in EVERYTHING])
    assert np.abs((fit.theta - machine.layout.nominal)[known]).max() < 10.0


def test_without_noise_more_is_taken_for_identified_and_runs_away(study):
    """The negative control: what the noise drowns is what runs away."""
    machine, poses = study.machine("six_pus/none"), study.poses
    symbols = tuple(s for s in EVERYTHING if s not in ("u_x", "u_y"))
    held = identify(machine, poses, symbols)
    fit = identify(machine, replace(poses, covariance=1e-8 * poses.covariance), symbols)
    assert fit.n_identified > held.n_identified
    assert np.abs(held.theta - machine.layout.nominal).max() < 10.0
    assert np.abs(fit.theta - machine.layout.nominal).max() > 20.0


def test_flexures_stay_nominal(study):
    machine = study.machine("stiffness/linear")
    symbols = ("b_x", "l", "kappa", "l_b", "k1_d", "k2_l")
    assert list_identified(machine, symbols) == ["b_x", "l", "kappa"]
    fit, without = identify(machine, study.poses, symbols), identify(machine, study.poses, symbols[:3])
    np.testing.assert_array_equal(fit.theta, without.theta)


def test_table_holds_what_was_found(study):
    table = tabulate_least_squares(study.inputs, study.fits)
    assert len(table) == sum(6 * len(study.free(name)) for name in study.fits)
    rows = table[(table["variant"] == "jacobian/none") & (table["parameter"] == "u_x")]
    np.testing.assert_array_equal(rows["offset"], study.find("jacobian/none")["u_x"])
    np.testing.assert_array_equal(rows["published_offset"], read_published("table5b")["u_x"])
    np.testing.assert_allclose(rows["leg_residual_rms_um"], 1e3 * study.fits["jacobian/none"].residual_rms)
    for name, fit in study.fits.items():  # no direction is dropped in the study
        assert fit.n_identified == 6 * len(study.free(name))
