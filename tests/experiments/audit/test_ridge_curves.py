"""Curves of ridges are where the machine goes, and theory explains the ridges that it should, and no others."""

from __future__ import annotations

from dataclasses import replace

import audit_problems as problems
import numpy as np
import pytest
import telescope_machines

from bayescal.experiments.audit import draws as ridge_curves
from bayescal.experiments.audit.audit import run_audit
from bayescal.experiments.audit.design import load_audit, read_inputs
from bayescal.experiments.audit.draws import MAX_DRAWS, audit_posterior, plot_ridges, tabulate_plots
from bayescal.experiments.frame.parallel import Run
from bayescal.identifiability.ridges import Leg, LevelLine, find_legs, list_laws
from bayescal.machines.kinematics import solve_forward_kinematics
from bayescal.numerics.geometry import compute_pose_error

pytestmark = pytest.mark.runs

LENGTHS, GAIN = "the distance of the joints along the leg", "the gain of the actuator along the leg"
DIRECTION, JOINT = "the direction of the actuator against the leg", "the place of the joint at home"
STRUT = "the length between the joints of the strut"


def _plot(name, draws=0):
    """Return inputs, audit and plots of a shipped design with so many draws."""
    path = problems.DESIGNS / f"{name}.toml"
    config = load_audit(path)
    config = config.model_copy(update={"posterior": config.posterior.model_copy(update={"draws": draws})})
    inputs = read_inputs(config, path.parent)
    audit = run_audit(inputs, Run())
    return inputs, audit, plot_ridges(inputs, audit, audit_posterior(inputs, audit, Run()))


@pytest.fixture(scope="module")
def linear():
    """Return inputs, audit and plots of the telescope with linear deformation before it is measured."""
    return _plot("telescope_six_pus_linear")


@pytest.fixture(scope="module")
def measured():
    """Return inputs, audit and plots of the measured telescope."""
    return _plot("telescope_posterior", 4000)


def _symbols(plot):
    return {name.partition("[")[0] for name in (plot.x, plot.y)}


@pytest.mark.parametrize("deformation", ["none", "linear", "matrix"])
@pytest.mark.parametrize("model", ["six_pus", "jacobian"])
def test_theory_explains_all_ridges_of_the_telescope(model, deformation):
    _, audit, plots = _plot(f"telescope_{model}_{deformation}")
    assert len(plots) == sum(direction.pivot is not None for direction in audit.analysis.directions)
    sources = [(LENGTHS, {"a_z", "l"}), (LENGTHS, {"b_z", "l"}), (JOINT, {"rho0", "a_z"})]
    if deformation == "none":
        sources.append((DIRECTION, {"u_x", "u_y"}))
    else:
        sources += [(GAIN, {"kappa", "u_x"}), (GAIN, {"kappa", "u_y"})]
    for source, symbols in sources:
        ours = [plot for plot in plots.values() if _symbols(plot) == symbols]
        assert ours, symbols
        for plot in ours:
            assert source in plot.explanation
            assert plot.angle < 2.0
            assert "analytic" in plot.curves


def test_a_leg_that_stands_otherwise_is_not_explained(linear, monkeypatch):
    """The direction of the legs comes from the machine; with that of its mirror image theory misses the ridges of u."""
    inputs, audit, plots = linear

    def mirrored(knowledge):
        return [
            Leg((-leg.base[0], -leg.base[1], leg.base[2]), (-leg.platform[0], -leg.platform[1], leg.platform[2]))
            for leg in find_legs(knowledge)
        ]

    monkeypatch.setattr(ridge_curves, "find_legs", mirrored)
    wrong = plot_ridges(inputs, audit, audit_posterior(inputs, audit, Run()))
    steep = [number for number, plot in plots.items() if _symbols(plot) & {"kappa"} and plot.angle is not None]
    assert len(steep) >= 6
    assert all(wrong[number].explanation is None for number in steep if not _is_lateral(inputs, plots[number]))


def _is_lateral(inputs, plot):
    """Return whether a ridge's direction stands across its leg, where the mirror image is the leg itself."""
    name = next(n for n in (plot.x, plot.y) if n.startswith("u_"))
    leg = find_legs(inputs.knowledge)[int(name[4:-1]) - 1]
    return abs(leg.base["xyz".index(name[2])]) < 0.1


def test_struts_are_explained_along_their_legs_only():
    """Axial struts of the M2 hexapod: z is along the leg, x and y are not, and nothing there is put down to chance."""
    inputs, _, plots = _plot("m2_hexapod")
    legs = find_legs(inputs.knowledge)
    found = 0
    for plot in plots.values():
        leg = int(plot.x[:-1].partition("[")[2]) - 1
        along = [abs(legs[leg].base["xyz".index(name[2])]) for name in (plot.x, plot.y) if name[1] == "_"]
        if max(along) < 0.1:
            assert plot.explanation is None, plot.x
        elif plot.explanation is not None:
            assert STRUT in plot.explanation
            found += 1
    assert found >= 12


# --- curves ------------------------------------------------------------------------------------------------------


def _follow(inputs, moves):
    """Return the largest change of a pose (mm) at the planned actuators for moves of parameters by name."""
    machine, theta = inputs.knowledge.machine, inputs.knowledge.centre[: inputs.knowledge.machine.layout.size]
    moved = theta.copy()
    for name, value in moves.items():
        moved[machine.layout.names.index(name)] = value
    one, other = (solve_forward_kinematics(machine, t, inputs.plan.actuators) for t in (theta, moved))
    change = compute_pose_error(other.position, other.rotation, one.position, one.rotation)
    return float(np.abs(change[:, :3]).max())


@pytest.mark.parametrize("leg", range(1, 7))
@pytest.mark.parametrize("axis", ["x", "y"])
def test_gain_curve_is_where_the_machine_goes(leg, axis, linear):
    """With u a tenth away and a following, poses change by what legs tilt: 0.6° times 0.1 times 1.3 mm, times two."""
    inputs, _, _ = linear
    knowledge = inputs.knowledge
    theta, layout = knowledge.centre, knowledge.layout
    law = next(law for law in list_laws(knowledge.machine) if law.ties(("kappa", f"u_{axis}")))
    start = {b.symbol: float(theta[layout.index[b.symbol][leg - 1]]) for b in knowledge.machine.layout.blocks}
    at_home = find_legs(knowledge)[leg - 1]
    line = LevelLine(law, at_home, start, {}, (f"u_{axis}", "kappa"), (0.05, 0.01))
    curve = line.trace(law.invariant(at_home, start))
    end = curve[np.argmin(np.abs(np.abs(curve[:, 0]) - 2.0))]
    tangent = line.tangent({f"u_{axis}": 0.05, "kappa": 0.01})
    changes = []
    for bend in (end[1], end[0] * tangent[1] / tangent[0]):
        u = {f"u_{axis}[{leg}]": start[f"u_{axis}"] + 0.05 * end[0]}
        turned = {f"u_{k}": start[f"u_{k}"] for k in "xy"} | {f"u_{axis}": next(iter(u.values()))}
        u_z = np.sqrt(1.0 - sum(v**2 for v in turned.values()))
        shift = {"x": turned["u_x"] - start["u_x"], "y": turned["u_y"] - start["u_y"], "z": u_z - 1.0}
        joint = {f"a_{k}[{leg}]": start[f"a_{k}"] - start["rho0"] * s for k, s in shift.items()}
        changes.append(_follow(inputs, u | joint | {f"kappa[{leg}]": start["kappa"] + 0.01 * bend}))
    assert changes[0] < 4e-3
    assert changes[1] > 8e-3


def test_home_joint_curve_changes_no_pose(linear):
    inputs, _, plots = linear
    plot = next(plot for plot in plots.values() if plot.x == "rho0[2]")
    x, y = plot.curves["analytic"][-1]
    assert abs(x - 10.0) > 1.0
    assert _follow(inputs, {plot.x: x, plot.y: y}) < 1e-9


def test_level_lines_close_on_themselves():
    """z·u = const is a circle about the leg; the azimuth turns once and the line ends where it began."""
    law = next(law for law in list_laws(telescope_machines.build_machine()) if law.ties(("u_x", "u_y")))
    z = np.array([0.0, 0.05, 1.0]) / np.hypot(0.05, 1.0)
    leg = Leg(tuple(z), tuple(z))
    line = LevelLine(law, leg, {"u_x": 0.0, "u_y": 0.0}, {}, ("u_x", "u_y"), (0.05, 0.05))
    circle = 0.05 * line.trace(law.invariant(leg, {"u_x": 0.0, "u_y": 0.0}))
    u = np.column_stack([circle, np.sqrt(1.0 - np.sum(circle**2, axis=1))])
    assert np.allclose(u @ z, z[2], atol=1e-8)
    assert np.linalg.norm(u[-1] - u[0]) < 0.1 * 0.05 * 2 + 0.01
    azimuth = np.unwrap(np.arctan2(circle[:, 1] - 0.05, circle[:, 0]))
    assert 0.9 * 2 * np.pi < np.ptp(azimuth) < 1.1 * 2 * np.pi


def test_a_line_that_hangs_on_other_parameters_is_no_law():
    """Across a strut the invariant hardly changes; what little it does gives no direction."""
    (law,) = list_laws(telescope_machines.build_machine(model="six_ups"))
    start = dict.fromkeys(("a_x", "a_y", "a_z", "b_x", "b_y", "b_z", "l"), 0.0)
    scale = dict.fromkeys(start, 0.5)
    across, along = Leg((1.0, 0.0, 1e-3), (1.0, 0.0, 1e-3)), Leg((0.0, 0.0, 1.0), (0.0, 0.0, 1.0))
    lines = [LevelLine(law, leg, start, {}, ("a_z", "b_z"), (0.5, 0.5)) for leg in (across, along)]
    assert lines[0].tangent(scale) is None
    assert np.allclose(np.divide(*lines[1].tangent(scale)), 1.0)


# --- what is drawn -----------------------------------------------------------------------------------------------


def _residual(points, curve):
    """Return the rms distance in y of points (S, 2) from a curve, of those within its reach."""
    order = np.argsort(curve[:, 0])
    x, y = curve[order].T
    inside = (points[:, 0] > x[0]) & (points[:, 0] < x[-1])
    return np.sqrt(np.mean((points[inside, 1] - np.interp(points[inside, 0], x, y)) ** 2))


def test_draws_lie_on_the_curve_and_the_prior_does_not(measured):
    _, _, plots = measured
    for plot in plots.values():
        if _symbols(plot) not in ({"a_z", "l"}, {"b_z", "l"}, {"rho0", "a_z"}):
            continue
        own, prior = (_residual(plot.points[s][:, 2:], plot.curves["analytic"]) for s in ("posterior", "prior"))
        assert own < 0.15 * prior


def test_draws_bend_with_the_curve(measured):
    """κ against u_x far from the middle: the draws lie below the tangent, as the curve does."""
    _, _, plots = measured
    ours = [plot for plot in plots.values() if "kappa" in _symbols(plot)]
    assert len(ours) >= 10
    below = []
    for plot in ours:
        (x0, y0), (x1, y1) = plot.curves["tangent"]
        points = plot.points["posterior"][:, 2:]
        far = np.abs(points[:, 0] - 0.5 * (x0 + x1)) > 0.07
        above = points[:, 1] - (y0 + (y1 - y0) / (x1 - x0) * (points[:, 0] - x0))
        below.append(above[far].mean() - above[~far].mean())
    assert np.mean(below) < -0.001
    assert sum(value < 0 for value in below) >= 0.9 * len(below)


def test_without_draws_the_forecast_is_drawn(linear):
    inputs, audit, plots = linear
    plot = plots[0]
    assert set(plot.points) == {"prior", "forecast"}
    knowledge = inputs.knowledge
    place = knowledge.names.index(plot.x)
    sd = np.sqrt(audit.analysis.information.covariance[place, place]) * knowledge.sd[place]
    chance = 5 / np.sqrt(2 * MAX_DRAWS)
    assert abs(plot.points["forecast"][:, 0].std() / sd - 1) < chance
    assert abs(plot.points["prior"][:, 0].std() / knowledge.sd[place] - 1) < chance
    assert abs(plot.points["prior"][:, 0].mean() - 10.0) < 0.2


def test_tables(measured):
    inputs, audit, plots = measured
    tables = tabulate_plots(plots)
    draws, curves = tables["ridge_draws"], tables["ridge_curves"]
    assert list(draws.columns) == ["direction", "source", "x", "y", "x_held", "y_held"]
    assert list(curves.columns) == ["direction", "source", "x", "y"]
    pivots = [k + 1 for k, d in enumerate(audit.analysis.directions) if d.pivot is not None]
    assert list(draws["direction"].unique()) == pivots
    assert draws.groupby(["direction", "source"]).size().max() <= MAX_DRAWS
    assert set(draws["source"]) == {"prior", "posterior"}
    assert np.isfinite(curves[["x", "y"]]).all(axis=None)
    assert plots[0].summary()["plot"]["x"] == inputs.knowledge.names[audit.analysis.directions[0].pivot]


def test_plots_are_in_the_designs_units(linear):
    inputs, audit, plots = linear
    micro = replace(inputs, units=replace(inputs.units, length="um"))
    other = plot_ridges(micro, audit, audit_posterior(micro, audit, Run()))
    plot = next(number for number, plot in plots.items() if _symbols(plot) == {"a_z", "l"})
    assert (other[plot].x_unit, plots[plot].x_unit) == ("um", "mm")
    assert np.allclose(other[plot].points["prior"], 1e3 * plots[plot].points["prior"])
    assert np.allclose(other[plot].curves["analytic"], 1e3 * plots[plot].curves["analytic"])
