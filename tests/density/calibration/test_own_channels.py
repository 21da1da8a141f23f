"""The model error of an arm's encoders, against plain formulas: covariances, levers, floors, terms that cannot be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import own_arm
import pytest

from bayescal.density.calibration.fixed_covariance import FixedCovarianceRows
from bayescal.density.calibration.likelihood import CalibrationLikelihood
from bayescal.density.calibration.measurements import Measurements, RowPositions
from bayescal.density.calibration.model_error import MIN_LEVER_RATIO, OF_NOISE, OwnChannelRows, build_model_error
from bayescal.density.calibration.terms import ErrorModel, NoiseFactor
from bayescal.density.components import assemble
from bayescal.density.low_rank_covariance import LowRankCovariance
from bayescal.density.pose_kernels import WAVE
from bayescal.density.posterior import Posterior
from bayescal.density.priors import NormalPrior
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings import Channel, FunctionModel

TERMS = ("random", "linear", "positioning", "smooth", "drift")
SD = np.array([5e-6] * 3 + [0.02] * 3)
HOME, REACH = np.array([0.0, 0.6, -1.2]), np.array([1.0, 0.4, 0.4])
N_ROWS, START = 12, 0.02


class Linear(own_arm.Arm):
    """An arm whose first encoder reads millimetres, and whose last is a constraint."""

    def __init__(self) -> None:
        super().__init__(None)
        self.channels[0] = Channel("encoder[1]", "mm")


def measure(machine, seed=4):
    """Return readings at poses of the workspace, some of them not taken, in an order that is not that of the rows."""
    model, rng = FunctionModel("arm", machine), np.random.default_rng(seed)
    pose = HOME + REACH * rng.uniform(-1.0, 1.0, (N_ROWS, 3))
    theta = model.layout.nominal + 1e-3 * rng.standard_normal(model.layout.size)
    values = model.read(theta, pose) + SD * rng.standard_normal((N_ROWS, 6))
    values[2, 1] = values[5, 0] = values[7, 4] = np.nan
    names = tuple(f"R{k}" for k in range(N_ROWS))
    order = np.roll(np.arange(N_ROWS), 5)
    return model, Measurements(names, values, np.tile(SD, (N_ROWS, 1)), order=order), pose


@pytest.fixture
def used():
    return np.arange(N_ROWS) % 4 != 1


@pytest.fixture
def arm(used):
    """Return an arm's own channels, its readings and their poses."""
    model, data, pose = measure(own_arm.Arm(None))
    return find_own(model, data, pose, used), model, data, pose


def find_own(model, data, pose, used, reach=(*REACH, 0.0, 0.0, 0.0)):
    """Return the own channels, of which those of the tool do not err."""
    expected = model.read(model.layout.nominal, pose)
    positions = RowPositions.find(model.channels, data, expected, np.append(HOME, np.zeros(3)))
    return OwnChannelRows.find(model, data, pose, used, positions, np.array(reach))


def terms_of(own, terms=TERMS, floors=(), each=False):
    return build_model_error(own, 6, terms, (0.01, 0.02), dict(floors), each)


def kernels(z, t):
    """Return k of two rows by sort and channel, as the method states them."""

    def smooth(a, b):
        return np.exp(-0.5 * np.sum((a - b) ** 2))

    return {
        "linear": lambda p, q, _: z[p] @ z[q],
        "positioning": lambda p, q, i: z[p, i] * z[q, i] + np.exp(-8.0 * (z[p, i] - z[q, i]) ** 2) / 16.0,
        "smooth": lambda p, q, _: smooth(z[p], z[q]) - smooth(z[p], 0 * z[p]) - smooth(z[q], 0 * z[q]) + 1.0,
        "drift": lambda p, q, _: min(t[p], t[q]) + START,
    }


@pytest.mark.parametrize("sort", TERMS[1:])
def test_covariance_of_a_sort_is_its_formula(sort, arm, used):
    own, model, data, pose = arm
    (term,) = terms_of(own, (sort,))
    columns = term.columns(np.array([[0.4]]), data)[0]
    scale = float(term.natural(np.array([[0.4]]))[0, 0])
    z = (model.read(model.layout.nominal, pose)[:, :3] - HOME) / (2.0 * REACH)
    k, rows = kernels(z, data.order / N_ROWS)[sort], np.flatnonzero(used)
    norm = np.mean([k(p, p, i) for p in rows for i in range(3)])
    for p in range(N_ROWS):
        for q in range(N_ROWS):
            expected = np.zeros((6, 6))
            for i in range(3):
                expected[i, i] = scale**2 * k(p, q, i) / norm / own.levers[i] ** 2
            found = columns[p] @ columns[q].T
            np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-7 * scale**2 / own.levers.min() ** 2)


def test_rows_held_back_and_further_ones_have_the_same_functions(arm, used):
    """Some of the rows, the same ones as new rows of another order, and new readings of a linear function."""
    own, _, data, _ = arm
    zeta = np.array([[0.4]])
    for term in terms_of(own, TERMS[1:]):
        whole = term.columns(zeta, data)
        np.testing.assert_array_equal(term.columns(zeta, data.pick(~used)), whole[:, ~used])
        if term.sort != "drift":  # of which the order is all
            stood = np.concatenate([own.rows.positions, data.values[:, 3:]], axis=1)[~used]
            again = replace(data.pick(~used), values=stood, order=np.array([100, 101, 102]))
            found = term.columns(zeta, again)
            np.testing.assert_allclose(found, whole[:, ~used], rtol=0.0, atol=1e-7 * np.abs(whole).max())
    linear, wave, *_ = terms_of(own, TERMS[1:])
    values = data.values.copy()[:1]
    values[0, :3] = HOME + 2.0 * REACH * [0.3, -0.2, 0.1]
    new = replace(data.pick(np.arange(1)), values=values, order=np.array([100]))
    square = np.sum(linear.columns(zeta, new)[0, 0, 1] ** 2) * own.levers[1] ** 2 * linear.functions.norms[0]
    assert square == pytest.approx(linear.amplitude(zeta)[0] ** 2 * (0.3**2 + 0.2**2 + 0.1**2), rel=1e-6)
    square = np.sum(wave.columns(zeta, new)[0, 0, 1] ** 2) * own.levers[1] ** 2 * wave.functions.norms[0]
    assert square <= wave.amplitude(zeta)[0] ** 2 * (0.2**2 + WAVE**2)  # what other rows tell of it


def test_functions_are_not_of_the_reading_whose_density_is_computed(arm, used):
    """Another number read at a row moves nothing that its errors are functions of; a command does."""
    _, model, data, pose = arm
    moved = replace(data, values=data.values + 0.1 * (np.arange(6) == 1))
    before, after = (find_own(model, one, pose, used).place.travel for one in (data, moved))
    np.testing.assert_array_equal(after, before)
    commanded = np.tile(np.arange(6) < 3, (N_ROWS, 1))
    first, second = (find_own(model, replace(one, commanded=commanded), pose, used) for one in (data, moved))
    np.testing.assert_allclose(
        first.place.travel,
        (np.where(data.present, data.values, model.read(model.layout.nominal, pose))[:, :3] - HOME) / (2.0 * REACH),
    )
    there = data.present[:, 1]
    np.testing.assert_allclose((second.place.travel - first.place.travel)[there, 1], 0.1 / (2.0 * REACH[1]))


def test_a_turn_more_is_the_same_position(used):
    """Positions of a channel on a circle go on where the expected one is, and around home at rows of others."""
    machine = own_arm.Arm(None)
    machine.channels[0] = Channel("encoder[1]", "rad", period=2.0 * np.pi)
    model, data, pose = measure(machine)
    commanded, turn = np.tile(np.arange(6) < 3, (N_ROWS, 1)), 2.0 * np.pi * (np.arange(6) == 0)
    for offset in (0.0, turn):
        own = find_own(model, replace(data, values=data.values + offset, commanded=commanded), pose, used)
        assert np.abs(own.place.travel[:, 0]).max() < 0.6
        other = replace(data.pick(used), values=data.values[used] + offset, order=100 + np.arange(used.sum()))
        assert np.abs(own.place_of(other).travel[:, 0]).max() < 0.6


class Geared(own_arm.Arm):
    """An arm whose encoders have gains, g q; ``cross``: and read each other, too."""

    def __init__(self, cross: bool) -> None:
        super().__init__(None)
        self.couplings = ("c0", "c1", "c2") if cross else ()
        self.parameters.append(ParameterBlock("g", (1.0, 1.0, 1.0), "1"))
        self.parameters += [ParameterBlock(name, (0.0, 0.0, 0.0), "1") for name in self.couplings]

    def read(self, parameters, v, given):
        found = super().read(parameters, v, given)
        turned = parameters["g"] * found[..., :3]
        for j, name in enumerate(self.couplings):
            turned = turned + parameters[name] * found[..., j : j + 1]
        return np.concatenate([turned, found[..., 3:]], axis=-1)


@pytest.mark.parametrize("cross", [False, True])
def test_functions_that_free_parameters_are_no_second_unknown(used, cross):
    """Gains are the own sort, all couplings the linear one; fixed they are neither, and each gain is its own."""
    model, data, pose = measure(Geared(cross))
    own, theta = find_own(model, data, pose, used), model.layout.nominal
    names = np.array([name.partition("[")[0] for name in model.layout.names])
    many = HOME + REACH * np.random.default_rng(2).uniform(-1.0, 1.0, (40, 3))

    def cover(free):
        return own.cover(model, np.eye(len(theta))[:, free], theta, many, {})

    free = np.isin(names, ["g", "c0", "c1", "c2"])
    found = cover(free)
    np.testing.assert_array_equal(found.covered, np.ones((3, 3), dtype=bool) if cross else np.eye(3, dtype=bool))
    assert not found.is_covered("positioning")  # waves are no parameters
    assert found.is_covered("linear") == cross
    assert not cover(~free).covered.any()
    only = cover(np.arange(len(names)) == np.flatnonzero(names == "g")[1])
    np.testing.assert_array_equal(only.covered, np.diag([False, True, False]))


class Scaled(own_arm.Arm):
    """An arm that is told its joints' angles, and whose tool moves by gains times them."""

    def __init__(self) -> None:
        super().__init__(None)
        self.parameters.append(ParameterBlock("g", (1.0, 1.0, 1.0), "1"))

    def tool(self, parameters, v):
        return super().tool(parameters, parameters["g"] * v)


def test_gains_of_the_tool_are_gains_of_the_channels_at_other_poses(used):
    """The coordinates are what encoders read: an error of these is a gain but for where poses are."""
    model, data, pose = measure(Scaled())
    theta, gains = model.layout.nominal, np.array([name.startswith("g[") for name in model.layout.names])
    many = HOME + REACH * np.random.default_rng(2).uniform(-1.0, 1.0, (40, 3))
    own = find_own(model, data, pose, used)
    found = own.cover(model, np.eye(len(theta))[:, gains], theta, many, {})
    np.testing.assert_array_equal(found.covered, np.eye(3, dtype=bool))


@pytest.mark.parametrize("few", [False, True])
def test_linear_functions_are_those_that_no_parameter_is(arm, used, few):
    """Of the own position there is none, and root mean squares are those stated; other sorts keep all they have."""
    plain, _, data, _ = arm
    own = replace(plain, covered=np.eye(3, dtype=bool))
    zeta, z = np.array([[0.4]]), own.place.travel[used]
    (term,) = build_model_error(own, 6, ("linear",), (0.01, 0.02), {}, False, few=few)
    columns, size = term.columns(zeta, data)[0][used], float(term.amplitude(zeta)[0])
    for i in range(3):
        others = np.delete(z, i, axis=1)
        fitted = others @ np.linalg.lstsq(others, columns[:, i])[0]
        np.testing.assert_allclose(columns[:, i], fitted, atol=1e-9 * size / own.levers[i])
    square = (columns[:, :3] ** 2).sum(axis=-1) * own.levers**2
    assert square.mean() == pytest.approx(size**2, rel=1e-6)
    for sort in ("smooth", "drift"):
        (one,), (same,) = (build_model_error(it, 6, (sort,), (0.01, 0.02), {}, False, few=few) for it in (own, plain))
        np.testing.assert_array_equal(one.columns(zeta, data), same.columns(zeta, data))


def test_levers_are_how_far_the_tool_moves_within_a_factor(arm, used):
    own, model, _, pose = arm
    step, nominal, moves = 1e-5, model.layout.nominal, []
    for i in range(3):
        move = step * np.eye(3)[i]  # an encoder reads the joint's angle
        apart = model.tool(nominal, pose[used] + move)[0] - model.tool(nominal, pose[used] - move)[0]
        moves.append(np.sqrt(np.mean(np.sum((apart / (2.0 * step)) ** 2, axis=1))))
    usual = np.median(np.array(moves) * SD[:3]) / SD[:3]
    expected = np.clip(moves, MIN_LEVER_RATIO * usual, usual / MIN_LEVER_RATIO)
    np.testing.assert_allclose(own.levers, expected, rtol=1e-6)
    assert (expected == moves).any()
    assert (expected != moves).any()


def test_levers_of_lengths_and_of_what_does_not_move_the_tool(used):
    """A channel in mm has lever one; where the tool's places are no lengths, noise is what there is."""
    model, data, pose = measure(Linear())
    found = find_own(model, data, pose, used)
    assert found.levers[0] == 1.0
    assert found.levers[1] > 100.0
    machine = own_arm.Arm(None)
    machine.tool_channels = tuple(Channel(one, "rad") for one in "abc")
    turning = find_own(FunctionModel("arm", machine), data, pose, used)
    np.testing.assert_allclose(turning.levers, OF_NOISE / SD[:3])


class Wrist(own_arm.Arm):
    """An arm whose base turns the tool about an axis that nearly goes through it."""

    def tool(self, parameters, v):
        x, y, z = np.moveaxis(super().tool(parameters, v), -1, 0)
        cosine, sine = np.cos(v[..., 0]), np.sin(v[..., 0])
        return np.stack([x * cosine + y * sine + cosine, sine + 0.0 * x, z], axis=-1)


def test_a_channel_that_hardly_moves_the_tool_has_a_share_of_the_usual_lever(used):
    model, data, pose = measure(Wrist(None))
    levers = find_own(model, data, pose, used).levers
    assert levers[1:].min() > 200.0
    assert levers[0] == pytest.approx(MIN_LEVER_RATIO * np.median(levers))


def test_constraints_and_channels_that_stay_do_not_err(used):
    model, data, pose = measure(own_arm.Arm(None))
    data.sd[:, 2] = 0.0
    assert find_own(model, data, pose, used, (1.0, 0.0, 0.4, 9.0, 9.0, 9.0)).names == ("encoder[1]",)


def test_one_tau_for_all_or_one_each(arm):
    own, _, data, _ = arm
    (shared,) = terms_of(own, ("random",))
    zeta = np.array([[0.3]])
    tau = float(shared.natural(zeta)[0, 0])
    expected = np.append((tau / own.levers) ** 2, np.zeros(3))
    np.testing.assert_allclose(shared.variance(zeta, data)[0, 0], expected)
    each = ErrorModel(terms_of(own, ("random",), each=True))
    assert each.names == ("tau[1]", "tau[2]", "tau[3]")
    assert each.units == ("mm",) * 3
    _, beside = each.noise(np.array([[0.3, -0.2, 0.1]]), data, data.sd)
    own_tau = each.natural(np.array([[0.3, -0.2, 0.1]]))[0]
    np.testing.assert_allclose(beside[0, 0], np.append(own_tau / own.levers, np.zeros(3)))


def test_floors_stay_where_no_error_is_seen(arm):
    own, _, data, _ = arm
    floors = {"random": 0.003, "linear": 0.004, "smooth": 0.005}
    low = np.array([[-30.0]])
    for term, name in zip(terms_of(own, floors=floors.items()), TERMS, strict=True):
        floor = floors.get(name, 0.0)
        if name == "random":
            np.testing.assert_allclose(term.variance(low, data)[0, 0, :3], (floor / own.levers) ** 2, rtol=1e-9)
            square = term.natural(np.array([[0.5]]))[0, 0] ** 2 + floor**2
            np.testing.assert_allclose(term.variance(np.array([[0.5]]), data)[0, 0, :3], square / own.levers**2)
        else:
            assert term.amplitude(low)[0] == pytest.approx(floor, abs=1e-15)
            s = term.natural(np.array([[0.5]]))[0, 0]
            assert term.amplitude(np.array([[0.5]]))[0] == pytest.approx(np.hypot(s, floor), rel=1e-12)


@pytest.mark.parametrize("floor", [0.0, 0.01])
@pytest.mark.parametrize("zeta", [-2.0, 0.3])
def test_slopes_of_terms_are_those_of_differences(zeta, floor, arm):
    own, _, data, _ = arm
    step, at = 1e-6, np.array([zeta])
    for term in terms_of(own, floors=dict.fromkeys(TERMS, floor).items()):
        found = term.slopes(at, data)
        if term.names == ("tau",):
            up, down = term.variance(at[None] + step, data), term.variance(at[None] - step, data)
            slope = np.broadcast_to((up - down) / (2.0 * step), found.variance.shape)
            np.testing.assert_allclose(found.variance, slope, rtol=1e-6)
        else:
            up, down = term.columns(at[None] + step, data), term.columns(at[None] - step, data)
            size = np.abs(up).max()
            np.testing.assert_allclose(found.columns, (up - down) / (2.0 * step), atol=1e-6 * size)


def posterior_of(arm, used):
    """Return the posterior of an arm's lengths with all terms, by columns."""
    own, model, data, pose = arm
    layout = model.layout
    priors = {name: NormalPrior(float(x), 0.5) for name, x in zip(layout.names, layout.nominal, strict=True)}
    priors = {name: one for name, one in priors.items() if not name.startswith("o")}
    likelihood = CalibrationLikelihood(model, data.pick(used), 1.0, pose[used])
    return Posterior(likelihood, priors, ErrorModel(terms_of(own)))


def test_rows_held_back_have_the_same_density_given_the_others_by_columns(arm, used):
    """Of the covariance of all rows about the anchor, for machines and sizes that differ."""
    _, model, data, pose = arm
    anchored, rng = posterior_of(arm, used).with_pose_guesses(), np.random.default_rng(3)
    held = CalibrationLikelihood(model, data.pick(~used), 1.0, pose[~used])
    y = np.tile(anchored.refine_geometry(np.zeros(anchored.n_parameters)), (5, 1))
    y[:, : anchored.n_geometry] += 3e-4 * rng.standard_normal((5, anchored.n_geometry))
    y[:, anchored.n_geometry :] += 0.7 * rng.standard_normal((5, 5))
    by_columns = anchored.exact().predict_density(held, y)
    np.testing.assert_allclose(anchored.predict_density(held, y), by_columns, atol=0.01)
    alone = held.density_by_row(*anchored.at(y))  # that others tell something of them shows
    assert np.abs(alone - by_columns).max() > 1.0
    y[2, 0] = np.nan
    assert (anchored.predict_density(held, y)[2] == -np.inf).all()


def test_rows_of_channels_that_were_not_read_are_left_out(arm, used):
    """The density, also of each row given the others, is that of all rows, where these are zero and white."""
    anchored, rng = posterior_of(arm, used).with_pose_guesses(), np.random.default_rng(3)
    likelihood, n = anchored.likelihood, anchored.n_geometry
    whole = FixedCovarianceRows.build(likelihood, anchored.errors, likelihood.frozen.anchor, whole=True)
    assert len(likelihood.frozen.kept) == len(whole.kept) - (~likelihood.data.present).sum() < len(whole.kept)
    y = np.tile(anchored.refine_geometry(np.zeros(anchored.n_parameters)), (5, 1))
    y += rng.standard_normal(y.shape) * np.repeat([3e-4, 0.7], [n, y.shape[1] - n])
    at = anchored.at(y)
    for found, expected in zip(*[[one.density, one.density_by_row] for one in (likelihood.frozen, whole)], strict=True):
        np.testing.assert_allclose(found(likelihood, *at), expected(likelihood, *at), rtol=1e-9)


def test_draws_of_functions_given_the_rows_are_those_by_columns(arm, used):
    """Mean and covariance of the errors at all rows, the held-back ones too: Matheron's rule beside coefficients."""
    _, _, data, _ = arm
    anchored, rng, n = posterior_of(arm, used).with_pose_guesses(), np.random.default_rng(3), 4000
    y = np.tile(anchored.refine_geometry(np.zeros(anchored.n_parameters)), (n, 1))
    y[:, anchored.n_geometry :] += [0.4, 1.0, -0.5, 0.3, 0.8]
    found = [one.likelihood.draw_common(*one.at(y), rng).at(data) for one in (anchored, anchored.exact())]
    sd = found[1][..., :3].reshape(n, -1).std(axis=0)
    first, second = (one[..., :3].reshape(n, -1) / sd for one in found)
    error = np.sqrt(2.0 / n)
    assert np.abs(first.mean(axis=0) - second.mean(axis=0)).max() < 5.0 * error
    assert np.abs(first.mean(axis=0)).max() > 20.0 * error
    assert np.abs(np.log(first.std(axis=0))).max() < 5.0 * error / np.sqrt(2.0)
    assert np.abs(np.corrcoef(first.T) - np.corrcoef(second.T)).max() < 5.0 * error


def test_functions_drawn_before_anything_is_read_have_the_sizes_of_their_terms(arm, used):
    own, _, data, _ = arm
    errors = ErrorModel(terms_of(own))
    zeta = np.tile([0.1, 0.4, -0.2, 0.3, 0.8], (2000, 1))
    _, *drawn = errors.draw_prior(zeta, data, np.random.default_rng(1)).by_term(data.pick(used))
    for term, one in zip(errors.terms[1:], drawn, strict=True):
        size = float(term.amplitude(zeta[:1, 1:2] * 0.0 + zeta[0, errors.terms.index(term)])[0])
        square = np.mean((one[..., :3] * own.levers) ** 2, axis=0).mean()
        assert np.sqrt(square) == pytest.approx(size, rel=0.05)


def test_gradient_of_a_posterior_is_that_of_differences(arm, used):
    posterior = posterior_of(arm, used)  # not anchored: by columns
    y = posterior.refine_geometry(np.zeros(posterior.n_parameters))
    y[posterior.n_geometry :] += [0.4, -0.6, 0.1, -0.3, 0.2]
    y[: posterior.n_geometry] += 1e-3
    gradient, _ = posterior.gradient(y)
    moves = 1e-4 * np.eye(len(y))
    expected = (posterior.log_density(y + moves) - posterior.log_density(y - moves)) / 2e-4
    np.testing.assert_allclose(gradient, expected, rtol=1e-6, atol=1e-4)


def test_terms_that_there_cannot_be(arm, used):
    own, model, data, pose = arm
    assert not own.find_missing(TERMS)
    few = find_own(model, data, pose, np.arange(N_ROWS) < 2)
    assert set(few.find_missing(TERMS)) == set(TERMS[1:])
    alone = find_own(model, data, pose, used, (0.0, 0.4, 0.0, 9.0, 9.0, 9.0))
    assert not alone.find_missing(TERMS)
    costly = dict.fromkeys(("positioning", "smooth", "drift"), "it costs too much")
    assert own.find_missing(TERMS, "it costs too much") == costly
    nothing = find_own(model, data, pose, used, (0.0, 0.0, 0.0, 9.0, 9.0, 9.0))
    assert set(nothing.find_missing(TERMS)) == set(TERMS)
    standing = replace(data, values=np.where(np.arange(6) < 3, np.append(HOME, np.zeros(3)), data.values))
    still = find_own(model, standing, np.tile(HOME, (N_ROWS, 1)), used)
    assert set(still.find_missing(TERMS)) == {"linear", "positioning", "smooth"}


# --- functions of few columns ----------------------------------------------------------------------------------------

ZETA = np.array([[0.3, 0.5, -0.4, 0.6, 0.2], [-0.5, 0.9, 0.1, 0.8, -0.3]])


@pytest.fixture(params=["shared", "each", "factor"])
def thin(request, arm, used):
    """Return a density by few columns, the same by whole matrices, the likelihood, its errors and coordinates."""
    own, model, data, pose = arm
    terms = build_model_error(own, 6, TERMS, (0.01, 0.02), {"smooth": 0.003}, request.param == "each", few=True)
    zeta = ZETA
    if request.param == "each":
        zeta = np.column_stack([ZETA[:, 0], ZETA[:, 0] - 0.3, ZETA[:, 0] + 0.2, ZETA[:, 1:]])
    if request.param == "factor":
        terms, zeta = (NoiseFactor("all", np.arange(6) > 2, 0.5), *terms), np.column_stack([[0.4, -0.2], ZETA])
    errors, theta = ErrorModel(terms), model.layout.nominal
    likelihood = CalibrationLikelihood(model, data.pick(used), 1.0, pose[used])
    few = FixedCovarianceRows.build(likelihood, errors, theta)
    acts = [np.where(likelihood.data.present[..., None], one, 0.0) for one in errors.list_acts(likelihood.data)]
    seen = [np.swapaxes(few.left, -1, -2) @ few.white.rows(one[None])[0] for one in acts]
    whole = replace(few, few=None, shown=tuple(one.reshape(-1, one.shape[-1]) for one in seen))
    return few, whole, likelihood, errors, zeta


def test_rows_of_few_columns_have_the_density_of_whole_matrices(thin):
    few, whole, likelihood, errors, zeta = thin
    assert isinstance(few.few, LowRankCovariance)
    nominal = likelihood.model.layout.nominal
    theta = nominal + 1e-4 * np.random.default_rng(8).standard_normal((2, len(nominal)))
    at = likelihood, theta, errors, zeta
    assert few.density(*at) == pytest.approx(whole.density(*at), rel=1e-9)
    assert few.density_by_row(*at) == pytest.approx(whole.density_by_row(*at), rel=1e-7)
    made = [one.linear_rows(likelihood, theta[0], np.eye(theta.shape[1]), errors) for one in (few, whole)]
    (square, half), (expected, other) = (one.square(zeta) for one in made)
    assert square == pytest.approx(expected, rel=1e-8, abs=1e-8 * np.abs(expected).max())
    assert half == pytest.approx(other, rel=1e-9)


def test_others_given_rows_of_few_columns_are_those_of_all_together(thin, arm, used):
    few, _, likelihood, errors, zeta = thin
    _, model, data, pose = arm
    theta = np.repeat(model.layout.nominal[None], 2, axis=0)
    other = CalibrationLikelihood(model, data.pick(~used), 1.0, pose[~used])
    found = few.density_of_others(likelihood, other, theta, errors, zeta)
    alone = few.density(likelihood, theta, errors, zeta)
    for k, row in enumerate(np.flatnonzero(~used)):
        rows = np.append(np.flatnonzero(used), row)
        both = CalibrationLikelihood(model, data.pick(rows), 1.0, pose[rows])
        together = FixedCovarianceRows.build(both, errors, theta[0]).density(both, theta, errors, zeta)
        assert found[:, k] == pytest.approx(together - alone, abs=1e-6)


@pytest.mark.runs
def test_coefficients_of_few_columns_are_drawn_given_the_rows(thin):
    few, whole, likelihood, errors, zeta = thin
    theta, n_draws = likelihood.model.layout.nominal[None], 2000
    rows = whole._find_rows(likelihood, theta)[0][0]
    amplitudes = errors.amplitudes(zeta[:1])[0]
    total = assemble(whole._blocks(likelihood, errors, zeta[:1]), whole.parts, amplitudes[None] ** 2)[0]
    columns = np.concatenate([size * one for size, one in zip(amplitudes, whole.shown, strict=True)], axis=1)
    gain = np.linalg.solve(total, columns).T
    drawn = few.draw(
        likelihood, np.tile(theta, (n_draws, 1)), errors, np.tile(zeta[:1], (n_draws, 1)), np.random.default_rng(3)
    )
    sd = np.sqrt(1.0 - np.einsum("ij,ji->i", gain, columns))
    assert np.abs((drawn.mean(axis=0) - gain @ rows) / sd).max() < 4.5 / np.sqrt(n_draws)
    assert drawn.std(axis=0) == pytest.approx(sd, rel=0.08)


def test_what_few_columns_leave_out_is_noise(arm, used):
    own, _, data, _ = arm
    whole, few = (build_model_error(own, 6, TERMS, (0.01, 0.02), {}, False, few=one) for one in (False, True))
    zeta = np.array([[0.4]])
    for one, other in zip(whole[1:], few[1:], strict=True):
        square = (one.columns(zeta, data.pick(used))[0] ** 2).sum(axis=-1)
        made = (other.columns(zeta, data.pick(used))[0] ** 2).sum(axis=-1) + other.variance(zeta, data)[0]
        assert (made[:, :3] * own.levers**2).mean() == pytest.approx((square[:, :3] * own.levers**2).mean(), rel=1e-9)
        step, found = 1e-6, other.slopes(zeta[0], data)
        up, down = other.variance(zeta + step, data), other.variance(zeta - step, data)
        slope = np.broadcast_to((up - down) / (2.0 * step), found.variance.shape)
        assert found.variance == pytest.approx(slope, rel=1e-6, abs=1e-12 * max(1e-9, np.abs(up).max()))
    assert few[4].left > 0.01
