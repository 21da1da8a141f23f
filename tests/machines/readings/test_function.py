"""A machine of one function: its derivatives by complex step, and what is refused."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from function_machines import point_on_lines
from refusals import line_of
from sliding_platforms import sliding_star, star_of

from bayescal.errors import InputError
from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings import Channel, Coordinate, FunctionModel, ReadingMachine
from bayescal.machines.readings.function import colour
from bayescal.numerics.analytic import absolute, atan2, norm


def test_a_machine_of_n_legs_costs_as_much_as_one_of_them():
    rounds = {n: len(star_of(n)._steps[True].places) for n in (3, 4, 6)}
    assert len(set(rounds.values())) == 1
    assert rounds[4] < star_of(4).layout.size / 2


def test_where_the_machine_cannot_stand_nothing_is_read():
    model = sliding_star()
    theta = model.layout.nominal.copy()
    theta[model.layout.index["l"][1]] = 50.0
    here = model.linearise(theta, model.home_pose[None])
    lost = np.array([name.endswith("[2]") for name in model.names])
    np.testing.assert_array_equal(np.isnan(here.values[0]), lost)
    np.testing.assert_array_equal(np.isnan(model.read(theta, model.home_pose)), lost)
    assert np.isnan(here.by_pose[0, lost]).any(axis=1).all()
    assert np.isfinite(here.by_parameters[0, ~lost]).all()


def test_columns_of_one_colour_share_no_row(rng):
    pattern = rng.random((7, 40)) < 0.2
    pattern[:, 5] = False
    colours = colour(pattern)
    assert colours[5] == -1
    for one in range(colours.max() + 1):
        assert pattern[:, colours == one].sum(axis=1).max() == 1


def test_without_a_tool_of_its_own_all_coordinates_have_to_be_accurate(rng):
    model = point_on_lines()
    pose = rng.uniform(-1.0, 1.0, (5, 2))
    position, by_pose, by_parameters = model.tool(model.layout.nominal, pose)
    np.testing.assert_array_equal(position, pose)
    np.testing.assert_array_equal(by_pose, np.broadcast_to(np.eye(2), (5, 2, 2)))
    assert by_parameters.shape == (5, 2, model.layout.size)
    assert not by_parameters.any()


class Beam(ReadingMachine):
    """A machine without coordinates: deflections under forces that the data give."""

    given = ("force",)
    coordinates = ()

    def __init__(self) -> None:
        self.parameters = [ParameterBlock("k", (2.0, 5.0)), ParameterBlock("w0", (0.1,), per_leg=False)]
        self.channels = [Channel("w[1]", "mm"), Channel("w[2]", "mm")]

    def read(self, parameters, v, given):
        return given["force"][..., None] / parameters["k"] + parameters["w0"][..., None]


class Pair(ReadingMachine):
    """A machine without coordinates that nothing has to be known of: it reads two lengths and their sum."""

    coordinates = ()

    def __init__(self) -> None:
        self.parameters = [ParameterBlock("l", (2.0, 5.0))]
        self.channels = [Channel("a", "mm"), Channel("b", "mm"), Channel("both", "mm")]

    def read(self, parameters, v, given):
        length = parameters["l"]
        return np.concatenate([length, length.sum(axis=-1, keepdims=True)], axis=-1)


def test_a_machine_without_coordinates(rng):
    model = FunctionModel("beam", Beam())
    force = rng.uniform(1.0, 3.0, 6)
    here = model.linearise(model.layout.nominal, np.empty((6, 0)), given={"force": force})
    assert here.by_pose.shape == (6, 2, 0)
    np.testing.assert_allclose(here.values, force[:, None] / [2.0, 5.0] + 0.1, rtol=1e-15)
    np.testing.assert_allclose(here.by_parameters[:, 1], np.stack([0 * force, -force / 25.0, 1.0 + 0 * force], axis=1))
    few = model.linearise(model.layout.nominal, np.empty((6, 0)), False, {"force": force})
    np.testing.assert_allclose(few.values, here.values, rtol=1e-15)
    assert few.by_pose.shape == (6, 2, 0)


def test_a_machine_of_parameters_alone_has_a_row_for_each_pose():
    model = FunctionModel("pair", Pair())
    theta = model.layout.nominal + np.arange(3.0)[:, None, None]
    assert model.read(theta, np.empty((4, 0))).shape == (3, 4, 3)
    here = model.linearise(theta, np.empty((4, 0)))
    assert here.values.shape == (3, 4, 3)
    np.testing.assert_array_equal(here.by_parameters, np.broadcast_to([[1, 0], [0, 1], [1, 1]], (3, 4, 3, 2)))


# --- refusals ----------------------------------------------------------------------------------------------------


class Arm(ReadingMachine):
    """A point at some distance; what it reads is a test's."""

    def __init__(self, read, **members) -> None:
        self.parameters = [ParameterBlock("x0", (3.0,), per_leg=False), ParameterBlock("y0", (-4.0,), per_leg=False)]
        self.coordinates = [Coordinate("x", "mm"), Coordinate("y", "mm")]
        self.channels = [Channel("near", "mm"), Channel("far", "mm")]
        self.own = read
        vars(self).update(members)

    def read(self, parameters, v, given):
        return self.own(v[..., 0] - parameters["x0"], v[..., 1] - parameters["y0"])


def plain(x, y):
    """Return two readings that are analytic."""
    return np.stack([x + 2.0 * y, x * y], axis=-1)


def ours(x, y):
    """Return the same with functions that a complex step can go through."""
    return np.stack([norm(np.stack([x, y], axis=-1)) + absolute(x), 1e-5 * atan2(y, x)], axis=-1)


def shortened(x, y):
    """Return two readings, the second's modulus taken by NumPy, small beside the first."""
    return np.stack([1e3 * (x + y), 1e-4 * np.abs(y)], axis=-1)


def crash(x, y):
    raise ValueError("no\nsuch  arm")


READS = {
    "shape": (lambda x, y: (x + y)[..., None], "Arm.read: found shape (5, 1) for 5 poses, expected (5, 2)"),
    "one pose": (lambda x, y: np.stack([x.ravel(), y.ravel()], axis=-1), "any leading axes"),
    "raises": (crash, "Arm.read: failed with ValueError: no such arm, expected readings"),
    "first axis": (lambda x, y: np.stack([x, y]), "found shape (2, 5) for 5 poses, expected (5, 2) of v (5, 2)"),
    "axes of a single value": (
        lambda x, y: np.stack([x, y], axis=-1) + np.stack([x, y]),
        "(2,5), expected readings (5, 2) of v (5, 2), parameters['x0'] (5,)",
    ),
    "nan": (lambda x, y: np.stack([x, np.sqrt(-(y**2) - 1.0)], axis=-1), "far: found nan at home, expected a finite"),
    "abs": (lambda x, y: np.stack([x, np.abs(y)], axis=-1), "far: found ∂/∂y0 = 0 by complex step, -1 by"),
    "abs of little": (shortened, "far: found ∂/∂y0 = 0 by complex step, -0.0001 by"),
    "norm": (
        lambda x, y: np.stack([np.linalg.norm(np.stack([x, y], axis=-1), axis=-1), y], axis=-1),
        "near: found ∂/∂x0 = 0 by complex step",
    ),
    "arctan2": (lambda x, y: np.stack([x, np.arctan2(y, x)], axis=-1), "with complex numbers: failed with TypeError"),
}


MEMBERS = {
    "no channels": ({"channels": None}, "found no channels, expected a sequence of Channel"),
    "a name": ({"channels": ["near"]}, "channels: found 'near', expected a Channel"),
    "twice": ({"channels": [Channel("s", "mm")] * 2}, "channels: found 's' twice"),
    "nothing": ({"parameters": []}, "class Arm: expected at least one parameter"),
    "rotation": (
        {"channels": [Channel("a", "rad", rotation="r"), Channel("b", "rad", rotation="r")]},
        "channels: found 2 of rotation 'r', expected three in a row",
    ),
    "apart": (
        {"channels": [Channel(name, "rad", rotation="" if name == "c" else "r") for name in "abcd"]},
        "channels: found 3 of rotation 'r', expected three in a row",
    ),
}


SLOPES = {
    "another": ([[1.0, 0.0], [0.0, 2.0]], "Arm.slopes: far: found ∂/∂y = 2, expected 1, that of read"),
    "nan": ([[1.0, 0.0], [0.0, np.nan]], "Arm.slopes: far: found ∂/∂y = nan, expected 1, that of read"),
    "too few": ([[1.0, 0.0]], "Arm.slopes: failed with ValueError: zip()"),
}
POINT = [Channel("x", "mm"), Channel("y", "mm")]


class Tooled(Arm):
    """The same with a tool, turned in some way, of a test's."""

    def __init__(self, tool=lambda p, v: v, turned=lambda v: None) -> None:
        super().__init__(plain, tool_channels=POINT)
        self.own_tool, self.turned = tool, turned

    def tool(self, parameters, v):
        return self.own_tool(parameters, v)

    def rotation(self, v):
        return self.turned(v)


TOOLS = {
    "axes of a single value": (
        Tooled(lambda p, v: v + np.stack([p["x0"], p["y0"]])),
        "of v (5, 2), parameters['x0'] (5,)",
    ),
    "turned by another axis": (Tooled(turned=lambda v: v - v[..., 0]), "rotation: failed with ValueError"),
    "turned by a vector": (Tooled(turned=lambda v: v), "rotation: found shape (5, 2) for 5 poses, expected (5, m, m)"),
    "turned all alike": (Tooled(turned=lambda v: np.eye(3)[:2]), "rotation: found shape (2, 3) for 5 poses"),
}
REFUSED = {
    **{f"tool, {what}": (machine, "class Tooled", text) for what, (machine, text) in TOOLS.items()},
    **{what: (Arm(read), "Arm.read", text) for what, (read, text) in READS.items()},
    **{what: (Arm(plain, **members), "class Arm", text) for what, (members, text) in MEMBERS.items()},
    **{
        f"slopes, {what}": (Arm(lambda x, y: np.stack([x, y], axis=-1), slopes=lambda *_, s=s: s), "Arm.slopes", text)
        for what, (s, text) in SLOPES.items()
    },
}


@pytest.mark.parametrize(("machine", "begin", "text"), REFUSED.values(), ids=REFUSED)
def test_a_wrong_class_is_refused_in_one_line(machine, begin, text):
    line = line_of(FunctionModel, "arm", machine)
    assert text in line
    assert line.startswith(f"machine 'arm': {begin}")


def test_a_member_that_was_never_set_is_refused():
    class Bare(ReadingMachine):
        def read(self, parameters, v, given):
            return v

    with pytest.raises(InputError, match=r"Bare: .*parameters.* ParameterBlock"):
        FunctionModel("bare", Bare(SimpleNamespace()))


def test_coordinates_of_several_points_are_no_rotation_of_as_many_axes():
    model = FunctionModel("arm", Arm(plain, coordinates=[Coordinate(name, "mm") for name in "xyuvw"]))
    np.testing.assert_array_equal(model.rotation_in_space(np.zeros((2, 5))), np.tile(np.eye(3), (2, 1, 1)))


@pytest.mark.parametrize("read", [plain, ours])
def test_analytic_functions_are_taken(read):
    model = FunctionModel("arm", Arm(read))
    assert model.linearise(model.layout.nominal, np.zeros((1, 2))).values.shape == (1, 2)


def test_closed_forms_stand_in_for_complex_steps(rng):
    def slopes(parameters, v, given):
        asked.append(v.shape)
        return [[1.0, 2.0], [v[..., 1] - parameters["y0"], v[..., 0] - parameters["x0"]]]

    arm, asked = Arm(plain), []
    exact = FunctionModel("arm", Arm(plain))
    arm.slopes = slopes
    model = FunctionModel("arm", arm)
    theta, pose = exact.layout.nominal + rng.uniform(-1.0, 1.0, (3, 1, 2)), rng.uniform(-1.0, 1.0, (5, 2))
    asked.clear()
    found, expected = (one.linearise(theta, pose, with_parameters=False) for one in (model, exact))
    np.testing.assert_allclose(found.by_pose, expected.by_pose, rtol=1e-14)
    np.testing.assert_array_equal(found.values, expected.values)
    assert asked == [(5, 2)]


def test_a_small_slope_beside_large_numbers_is_no_fault():
    """Differences cannot see it for rounding, which is no reason to refuse it."""

    def offset(x, y):
        return np.stack([np.sqrt((x + 1e5) ** 2 + 1e-4 * y**2) - 1e5, (x + 1e5) ** 2 - 1e10 + 1e-9 * y], axis=-1)

    FunctionModel("arm", Arm(offset))


class Crank(ReadingMachine):
    """A crank whose pin's height is read, which two angles have: one before, one after its top."""

    def __init__(self) -> None:
        self.parameters = [ParameterBlock("r", (1.0,), per_leg=False)]
        self.coordinates = [Coordinate("angle", "rad", home=-1.0, reach=2.5)]
        self.channels = [Channel("height", "mm")]

    def read(self, parameters, v, given):
        return parameters["r"][..., None] * np.sin(v)


def test_commands_are_followed_from_home_on_its_branch():
    """A Newton step from home alone would pass the top, and end on the other side of it."""
    model = FunctionModel("crank", Crank())
    pose, found = model.locate(model.layout.nominal, np.array([[-0.5], [0.99], [1.5]]))
    np.testing.assert_allclose(pose[:2, 0], np.arcsin([-0.5, 0.99]), rtol=0, atol=1e-10)
    assert found.tolist() == [True, True, False]
    assert np.isnan(pose[2]).all()
    near, there = model.locate(model.layout.nominal, np.array([[0.99]]), start=np.array([[1.8]]))
    np.testing.assert_allclose(near, [[np.pi - np.arcsin(0.99)]], rtol=0, atol=1e-10)
    assert there.all()
