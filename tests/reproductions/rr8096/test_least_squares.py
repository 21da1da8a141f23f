"""Least squares as in RR-8096 section 7: its tables come back from the twin of table 7 (a)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import studies
import telescope_machines as machines

from bayescal.density.least_squares import identify, list_identified, minimise
from bayescal.experiments.study.tables import identify_variants, tabulate_flexure, tabulate_least_squares
from bayescal.files.csv_tables import read_table

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


@pytest.fixture(scope="module")
def inputs():
    return studies.load_study(studies.TELESCOPE / "study.toml")


@pytest.fixture(scope="module")
def poses(inputs):
    return inputs.poses(verification=False)


@pytest.fixture(scope="module")
def identified(inputs):
    return identify_variants(inputs)


@pytest.fixture(scope="module")
def fits(inputs, identified):
    """Return the identified offsets by symbol and the fit, for every variant."""
    result = {}
    for variant in inputs.config.variants:
        machine, fit = inputs.machine(variant), identified[variant.name]
        offset = fit.theta - machine.layout.nominal
        result[variant.name] = ({s: machine.layout.take(offset, s) for s in variant.free}, fit)
    return result


def join(offsets: dict[str, np.ndarray], symbols=LENGTHS) -> np.ndarray:
    return np.concatenate([offsets[symbol] for symbol in symbols])


def rms_of_lengths(found: dict[str, np.ndarray], published: dict[str, np.ndarray]) -> float:
    return float(np.sqrt(np.mean((join(found) - join(published)) ** 2)))


# --- the published tables --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("variant", "table"),
    [
        ("six_pus/none", "table5a"),
        ("six_pus/linear", "table6a"),
        ("beam/none", "table5c"),
        ("beam/linear", "table6c"),
    ],
)
def test_published_lengths_come_back(fits, variant, table):
    found, fit = fits[variant]
    assert fit.converged
    assert rms_of_lengths(found, read_published(table)) < 0.35


def test_other_tables_fail_the_same_bound(fits):
    assert rms_of_lengths(fits["six_pus/none"][0], read_published("table7a")) > 0.35
    assert rms_of_lengths({s: np.zeros(6) for s in LENGTHS}, read_published("table5a")) > 0.35


def test_published_directions_come_back(fits):
    found, published = fits["six_pus/none"][0]["u_x"], read_published("table5a")["u_x"]
    np.testing.assert_array_equal(np.sign(found), np.sign(published))
    np.testing.assert_allclose(found, published, atol=0.03, rtol=0)


def test_directions_move_the_attachment_to_keep_the_home_joint(fits):
    none, linear = fits["six_pus/none"][0], fits["six_pus/linear"][0]
    np.testing.assert_allclose(none["a_x"] - linear["a_x"], -INITIAL_POSITION * none["u_x"], atol=0.1)
    five, six = read_published("table5a"), read_published("table6a")
    np.testing.assert_allclose(five["a_x"] - six["a_x"], -INITIAL_POSITION * five["u_x"], atol=0.1)


def test_truth_of_the_twin_comes_back_where_the_model_is_right(fits):
    for variant in ("six_pus/matrix", "beam/matrix", "stiffness/matrix"):
        found, fit = fits[variant]
        assert rms_of_lengths(found, read_published("table7a")) < 0.15
        np.testing.assert_allclose(found["kappa"], read_published("table7a")["kappa"], atol=1e-3)
        assert fit.residual_rms.max() < 5e-3
        assert fits[variant.replace("matrix", "none")][1].residual_rms.min() > 2 * fit.residual_rms.max()


@pytest.mark.parametrize(("deformation", "table"), [("none", "5"), ("linear", "6")])
def test_objective_in_newtons_moves_the_points_as_published(fits, inputs, poses, deformation, table):
    """Tables (d) minus tables (a): the pattern comes with the objective, not with the model."""
    variant = inputs.variant(f"stiffness/{deformation}")
    machine = inputs.machine(variant)
    in_lengths = identify(machine, poses, tuple(variant.free), objective=np.eye(6))
    offset = in_lengths.theta - machine.layout.nominal
    base = join(fits[f"six_pus/{deformation}"][0], POINTS)
    published = join(read_published(f"table{table}d"), POINTS)
    moved = published - join(read_published(f"table{table}a"), POINTS)
    found = {
        "newtons": join(fits[variant.name][0], POINTS),
        "lengths": join({s: machine.layout.take(offset, s) for s in POINTS}, POINTS),
    }
    alike = {name: np.corrcoef(values - base, moved)[0, 1] for name, values in found.items()}
    apart = {name: np.sqrt(np.mean((values - published) ** 2)) for name, values in found.items()}
    assert alike["newtons"] > 0.7
    assert alike["lengths"] < 0.0
    assert apart["newtons"] < apart["lengths"]


# --- what is minimised -----------------------------------------------------------------------------------------------


def compute_gradient(machine, poses, theta, free, weight) -> np.ndarray:
    """Return the gradient of the sum of squares in units of its terms' size: cosines of residual and columns."""
    here = machine.linearise(theta, poses.position, poses.rotation, poses.actuators)
    residual = (here.residual @ weight.T).ravel()
    jacobian = (weight @ here.parameters[..., free]).reshape(len(residual), -1)
    return jacobian.T @ residual / (np.linalg.norm(jacobian, axis=0) * np.linalg.norm(residual))


@pytest.mark.parametrize("variant", ["six_pus/linear", "jacobian/none", "beam/matrix", "stiffness/linear"])
def test_the_models_own_objective_is_at_its_minimum(inputs, poses, fits, variant):
    machine, fit = inputs.machine(inputs.variant(variant)), fits[variant][1]
    free = np.concatenate([machine.layout.index[s] for s in inputs.variant(variant).free])
    weight = machine.model.objective(machine.mechanism)
    assert np.abs(compute_gradient(machine, poses, fit.theta, free, weight)).max() < 1e-5
    residual = machine.linearise(fit.theta, poses.position, poses.rotation, poses.actuators).residual
    assert fit.objective == pytest.approx(np.sum((residual @ weight.T) ** 2), rel=1e-9)
    np.testing.assert_allclose(fit.residual_rms, np.sqrt(np.mean(residual**2, axis=0)), rtol=1e-9)
    away = fit.theta + 1e-3 * np.isin(np.arange(machine.layout.size), free)
    assert np.abs(compute_gradient(machine, poses, away, free, weight)).max() > 1e-4


def test_newtons_and_lengths_have_different_minima(inputs, poses, fits):
    machine, fit = inputs.machine(inputs.variant("stiffness/linear")), fits["stiffness/linear"][1]
    free = np.concatenate([machine.layout.index[s] for s in inputs.variant("stiffness/linear").free])
    assert np.abs(compute_gradient(machine, poses, fit.theta, free, np.eye(6))).max() > 0.1


def test_start_does_not_matter(inputs, poses, fits, rng):
    """Even where a direction starts on its leg's slope, at which nothing depends on it."""
    variant = inputs.variant("six_pus/none")
    machine, best = inputs.machine(variant), fits[variant.name][1]
    layout = machine.layout
    free = np.concatenate([layout.index[s] for s in variant.free])
    for slope in (-0.0571, 0.0571, 0.3):
        start = layout.nominal.copy()
        start[free] += rng.standard_normal(len(free))
        start[layout.index["u_x"]] = slope
        fit = identify(machine, poses, tuple(variant.free), start)
        np.testing.assert_allclose(fit.theta, best.theta, atol=1e-5)
        assert fit.objective == pytest.approx(best.objective, rel=1e-9)


def test_mirrored_directions_are_worse_minima(inputs, poses, fits):
    """The negative control: from the other side of a slope one descent alone ends elsewhere."""
    variant = inputs.variant("six_pus/none")
    machine, best = inputs.machine(variant), fits[variant.name][1]
    free = np.concatenate([machine.layout.index[s] for s in variant.free])
    start = best.theta.copy()
    start[machine.layout.index["u_x"][0]] = 0.5
    other = minimise(machine, poses, free, start, np.eye(6))
    assert other.converged
    assert other.theta[machine.layout.index["u_x"][0]] > 0.4
    assert other.objective > 1.001 * best.objective


# --- nothing runs away -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["six_pus", "jacobian", "beam", "stiffness"])
def test_with_everything_free_six_directions_per_leg_are_identified(inputs, poses, model):
    machine = inputs.machine(inputs.variant(f"{model}/none"))
    fit = identify(machine, poses, tuple(block.symbol for block in machine.layout.blocks))
    assert fit.converged
    assert fit.n_identified == 36
    known = np.concatenate([machine.layout.index[s] for s in EVERYTHING])
    assert np.abs((fit.theta - machine.layout.nominal)[known]).max() < 10.0


def test_without_noise_more_is_taken_for_identified_and_runs_away(inputs, poses):
    """The negative control: what the noise drowns is what runs away."""
    machine = inputs.machine(inputs.variant("six_pus/none"))
    symbols = tuple(s for s in EVERYTHING if s not in ("u_x", "u_y"))
    held = identify(machine, poses, symbols)
    fit = identify(machine, replace(poses, covariance=1e-8 * poses.covariance), symbols)
    assert fit.n_identified > held.n_identified
    assert np.abs(held.theta - machine.layout.nominal).max() < 10.0
    assert np.abs(fit.theta - machine.layout.nominal).max() > 20.0


def test_flexures_stay_nominal(inputs, poses):
    machine = inputs.machine(inputs.variant("stiffness/linear"))
    symbols = ("b_x", "l", "kappa", "l_b", "k1_d", "k2_l")
    assert list_identified(machine, symbols) == ["b_x", "l", "kappa"]
    fit, without = identify(machine, poses, symbols), identify(machine, poses, symbols[:3])
    np.testing.assert_array_equal(fit.theta, without.theta)


def test_no_direction_is_dropped_in_the_study(inputs, fits):
    for variant in inputs.config.variants:
        assert fits[variant.name][1].n_identified == 6 * len(variant.free)
        assert fits[variant.name][1].converged


# --- tables ----------------------------------------------------------------------------------------------------------


def test_table_holds_what_was_found(inputs, identified, fits):
    table = tabulate_least_squares(inputs, identified)
    assert len(table) == sum(6 * len(v.free) for v in inputs.config.variants)
    rows = table[(table["variant"] == "jacobian/none") & (table["parameter"] == "u_x")]
    np.testing.assert_array_equal(rows["offset"], fits["jacobian/none"][0]["u_x"])
    np.testing.assert_array_equal(rows["published_offset"], read_published("table5b")["u_x"])
    np.testing.assert_allclose(rows["leg_residual_rms_um"], 1e3 * fits["jacobian/none"][1].residual_rms)


def test_table_of_the_flexures():
    table = tabulate_flexure(machines.build_telescope())
    assert table["bending_deg"].iloc[[0, -1]].tolist() == [0.0, 1.0]
    last = table.iloc[-1]
    assert last["along_pivot_um"] / last["along_beam_um"] == pytest.approx(1.5, abs=1e-3)
    assert 0.01 < last["circle_error_nm"] < 0.1
    assert last["circle_error_nm"] == pytest.approx(1e3 * (last["along_circle_um"] - last["along_beam_um"]), rel=1e-6)
    assert last["across_um"] == pytest.approx(1e3 * 5.0 * np.radians(1.0))
    lengths = machines.build_flexures(6).lengths * np.array([1, 1, 2, 2, 1, 1])
    two = tabulate_flexure(machines.build_telescope(flexures=replace(machines.build_flexures(6), lengths=lengths)))
    assert len(two) == 2 * len(table)
    assert tabulate_flexure(machines.build_telescope(flexures=None)).empty
