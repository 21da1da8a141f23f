"""Least squares as in RR-8096 section 7: its tables come back from the twin of table 7 (a)."""

from __future__ import annotations

from dataclasses import replace

import hexapods
import numpy as np
import papers
import pytest
import studies
import telescope_machines as machines

from bayescal.errors import InputError
from rr8096.identified import identify_variants, list_free, machine_of, read_tables, tabulate_least_squares
from rr8096.least_squares import identify, list_identified, minimise
from rr8096.published import FILES, read_published

POINTS = ("a_x", "a_y", "b_x", "b_y")
LENGTHS = (*POINTS, "l")
INITIAL_POSITION = 10.0
EVERYTHING = ("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "u_x", "u_y", "l", "rho0")
STROKE = 14.1  # mm, of the hexapods' actuators


def read_printed(variant: str) -> dict[str, np.ndarray]:
    """Return the offsets of a variant's published table by symbol; mm, dimensionless."""
    values = read_published(FILES[variant])
    return {s: np.array([values[s, leg] for leg in range(1, 7)]) for s in dict.fromkeys(s for s, _ in values)}


@pytest.fixture(scope="module")
def inputs():
    return studies.load_study(studies.TELESCOPE / "study.toml")


@pytest.fixture(scope="module")
def poses(inputs):
    return inputs.measured[0].poses.select(~inputs.measured[0].verification)


@pytest.fixture(scope="module")
def seen(inputs):
    """Return the machine and the free symbols of every variant."""
    return {name: (machine_of(one), list_free(one)) for name, one in inputs.variants.items()}


@pytest.fixture(scope="module")
def identified(inputs):
    return identify_variants(inputs)


@pytest.fixture(scope="module")
def fits(seen, identified):
    """Return the identified offsets by symbol and the fit, for every variant."""
    result = {}
    for name, (machine, free) in seen.items():
        offset = identified[name].theta - machine.layout.nominal
        result[name] = ({s: machine.layout.take(offset, s) for s in free}, identified[name])
    return result


def join(offsets: dict[str, np.ndarray], symbols=LENGTHS) -> np.ndarray:
    return np.concatenate([offsets[symbol] for symbol in symbols])


def rms_of_lengths(found: dict[str, np.ndarray], published: dict[str, np.ndarray]) -> float:
    return float(np.sqrt(np.mean((join(found) - join(published)) ** 2)))


def test_shipped_study_builds_every_variant(inputs):
    assert list(inputs.variants) == [one.name for one in inputs.config.variants]
    models, deformations = ("six_pus", "jacobian", "beam", "stiffness"), ("none", "linear", "matrix")
    assert [v.name for v in inputs.config.variants] == [f"{m}/{d}" for m in models for d in deformations]
    assert inputs.measured[0].poses.n_poses == 46
    assert int(inputs.verification.sum()) == 6


# --- the published tables --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("variant", ["six_pus/none", "six_pus/linear", "beam/none", "beam/linear"])
def test_published_lengths_come_back(fits, variant):
    found, fit = fits[variant]
    assert fit.converged
    assert rms_of_lengths(found, read_printed(variant)) < 0.35


def test_other_tables_fail_the_same_bound(fits):
    assert rms_of_lengths(fits["six_pus/none"][0], read_printed("six_pus/matrix")) > 0.35
    assert rms_of_lengths({s: np.zeros(6) for s in LENGTHS}, read_printed("six_pus/none")) > 0.35


def test_published_directions_come_back(fits):
    found, published = fits["six_pus/none"][0]["u_x"], read_printed("six_pus/none")["u_x"]
    np.testing.assert_array_equal(np.sign(found), np.sign(published))
    np.testing.assert_allclose(found, published, atol=0.03, rtol=0)


def test_directions_move_the_attachment_to_keep_the_home_joint(fits):
    none, linear = fits["six_pus/none"][0], fits["six_pus/linear"][0]
    np.testing.assert_allclose(none["a_x"] - linear["a_x"], -INITIAL_POSITION * none["u_x"], atol=0.1)
    five, six = read_printed("six_pus/none"), read_printed("six_pus/linear")
    np.testing.assert_allclose(five["a_x"] - six["a_x"], -INITIAL_POSITION * five["u_x"], atol=0.1)


def test_truth_of_the_twin_comes_back_where_the_model_is_right(fits):
    for variant in ("six_pus/matrix", "beam/matrix", "stiffness/matrix"):
        found, fit = fits[variant]
        assert rms_of_lengths(found, read_printed("six_pus/matrix")) < 0.15
        np.testing.assert_allclose(found["kappa"], read_printed("six_pus/matrix")["kappa"], atol=1e-3)
        assert fit.residual_rms.max() < 5e-3
        assert fits[variant.replace("matrix", "none")][1].residual_rms.min() > 2 * fit.residual_rms.max()


@pytest.mark.parametrize("deformation", ["none", "linear"])
def test_objective_in_newtons_moves_the_points_as_published(fits, seen, poses, deformation):
    """Tables (d) minus tables (a): the pattern comes with the objective, not with the model."""
    own, reference = f"stiffness/{deformation}", f"six_pus/{deformation}"
    machine, free = seen[own]
    in_lengths = identify(machine, poses, free, objective=np.eye(6))
    offset = in_lengths.theta - machine.layout.nominal
    base = join(fits[reference][0], POINTS)
    published = join(read_printed(own), POINTS)
    moved = published - join(read_printed(reference), POINTS)
    found = {
        "newtons": join(fits[own][0], POINTS),
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
def test_the_models_own_objective_is_at_its_minimum(seen, poses, fits, variant):
    (machine, symbols), fit = seen[variant], fits[variant][1]
    free = np.concatenate([machine.layout.index[s] for s in symbols])
    weight = machine.model.objective(machine.mechanism)
    assert np.abs(compute_gradient(machine, poses, fit.theta, free, weight)).max() < 1e-5
    residual = machine.linearise(fit.theta, poses.position, poses.rotation, poses.actuators).residual
    assert fit.objective == pytest.approx(np.sum((residual @ weight.T) ** 2), rel=1e-9)
    np.testing.assert_allclose(fit.residual_rms, np.sqrt(np.mean(residual**2, axis=0)), rtol=1e-9)
    away = fit.theta + 1e-3 * np.isin(np.arange(machine.layout.size), free)
    assert np.abs(compute_gradient(machine, poses, away, free, weight)).max() > 1e-4


def test_newtons_and_lengths_have_different_minima(seen, poses, fits):
    (machine, symbols), fit = seen["stiffness/linear"], fits["stiffness/linear"][1]
    free = np.concatenate([machine.layout.index[s] for s in symbols])
    assert np.abs(compute_gradient(machine, poses, fit.theta, free, np.eye(6))).max() > 0.1


def test_start_does_not_matter(seen, poses, fits, rng):
    """Even where a direction starts on its leg's slope, at which nothing depends on it."""
    (machine, symbols), best = seen["six_pus/none"], fits["six_pus/none"][1]
    layout = machine.layout
    free = np.concatenate([layout.index[s] for s in symbols])
    for slope in (-0.0571, 0.0571, 0.3):
        start = layout.nominal.copy()
        start[free] += rng.standard_normal(len(free))
        start[layout.index["u_x"]] = slope
        fit = identify(machine, poses, symbols, start)
        np.testing.assert_allclose(fit.theta, best.theta, atol=1e-5)
        assert fit.objective == pytest.approx(best.objective, rel=1e-9)


def test_mirrored_directions_are_worse_minima(seen, poses, fits):
    """The negative control: from the other side of a slope one descent alone ends elsewhere."""
    (machine, symbols), best = seen["six_pus/none"], fits["six_pus/none"][1]
    free = np.concatenate([machine.layout.index[s] for s in symbols])
    start = best.theta.copy()
    start[machine.layout.index["u_x"][0]] = 0.5
    other = minimise(machine, poses, free, start, np.eye(6))
    assert other.converged
    assert other.theta[machine.layout.index["u_x"][0]] > 0.4
    assert other.objective > 1.001 * best.objective


# --- nothing runs away -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["six_pus", "jacobian", "beam", "stiffness"])
def test_with_everything_free_six_directions_per_leg_are_identified(seen, poses, model):
    machine, _ = seen[f"{model}/none"]
    fit = identify(machine, poses, tuple(block.symbol for block in machine.layout.blocks))
    assert fit.converged
    assert fit.n_identified == 36
    known = np.concatenate([machine.layout.index[s] for s in EVERYTHING])
    assert np.abs((fit.theta - machine.layout.nominal)[known]).max() < 10.0


def test_without_noise_more_is_taken_for_identified_and_runs_away(seen, poses):
    """The negative control: what the noise drowns is what runs away."""
    machine, _ = seen["six_pus/none"]
    symbols = tuple(s for s in EVERYTHING if s not in ("u_x", "u_y"))
    held = identify(machine, poses, symbols)
    fit = identify(machine, replace(poses, covariance=1e-8 * poses.covariance), symbols)
    assert fit.n_identified > held.n_identified
    assert np.abs(held.theta - machine.layout.nominal).max() < 10.0
    assert np.abs(fit.theta - machine.layout.nominal).max() > 20.0


def test_flexures_stay_nominal(seen, poses):
    machine, _ = seen["stiffness/linear"]
    symbols = ("b_x", "l", "kappa", "l_b", "k1_d", "k2_l")
    assert list_identified(machine, symbols) == ["b_x", "l", "kappa"]
    fit, without = identify(machine, poses, symbols), identify(machine, poses, symbols[:3])
    np.testing.assert_array_equal(fit.theta, without.theta)


def test_no_direction_is_dropped_in_the_study(seen, identified):
    for name, (_, free) in seen.items():
        assert identified[name].n_identified == 6 * len(free)
        assert identified[name].converged


@pytest.mark.parametrize("name", hexapods.LIMITS)
def test_struts_lengths_come_back(name, rng):
    """Another drive: the hexapods of Rubin Observatory."""
    machine = machines.build_machine("none", hexapods.load_hexapod(name), "six_ups")
    theta = machine.layout.nominal.copy()
    theta[machine.layout.index["l"]] += rng.standard_normal(6)
    actuators = STROKE * rng.uniform(-1, 1, (20, 6))
    poses = machines.place_poses(machine, theta, actuators, np.zeros((20, 6)))
    fit = identify(machine, poses, ("l",))
    assert fit.converged
    assert fit.n_identified == 6
    np.testing.assert_allclose(fit.theta, theta, rtol=0, atol=1e-9)


# --- tables ----------------------------------------------------------------------------------------------------------


def test_table_holds_what_was_found(inputs, identified, seen, fits):
    table = tabulate_least_squares(inputs, identified)
    assert len(table) == sum(6 * len(free) for _, free in seen.values())
    rows = table[(table["variant"] == "jacobian/none") & (table["parameter"] == "u_x")]
    np.testing.assert_array_equal(rows["offset"], fits["jacobian/none"][0]["u_x"])
    np.testing.assert_array_equal(rows["published_offset"], read_printed("jacobian/none")["u_x"])
    np.testing.assert_allclose(rows["leg_residual_rms_um"], 1e3 * fits["jacobian/none"][1].residual_rms)


def test_every_variant_has_its_printed_table(inputs):
    assert list(read_tables(inputs)) == list(inputs.variants)
    assert FILES["six_pus/none"].name == "table5a.csv"
    assert FILES["stiffness/matrix"].name == "table7d.csv"
    assert papers.claims.Rr8096().describe()["tables"]["beam/linear"] == "table 6(c)"


@pytest.mark.runs
def test_what_frees_more_than_the_report_has_no_printed_table():
    ridges = studies.load_study(studies.TELESCOPE / "ridges.toml")
    assert read_tables(ridges) == {}


def test_faulty_printed_table(tmp_path):
    text = FILES["six_pus/matrix"].read_text()
    path = tmp_path / "table.csv"
    for old, new, expected in ((",mm,", ",km,", "found 'km', expected one of mm, 1, 1e-3"), ("leg6", "leg7", "leg6")):
        path.write_text(text.replace(old, new, 1))
        with pytest.raises(InputError, match=expected):
            read_published(path)
