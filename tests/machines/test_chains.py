"""Chains of joints against a reader of URDF of its own and products of Denavit-Hartenberg's; files that are none."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from refusals import line_of
from serial_arms import JOINTS, PANDA, SMALL, list_masses, multiply, place_links, write_small

from bayescal.errors import InputError
from bayescal.machines.chains import Chain, DenavitRow, Joint, Place, chain_rows, read_urdf

NANOMETRE = 1e-6  # mm


def follow(chain: Chain, q) -> list[Place]:
    """Return where the frame of each joint stands once it has moved, and the tip."""
    here, found = Place(), []
    for joint, value in zip(chain.joints, q, strict=True):
        s, c = np.sin(value), np.cos(value)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        moved = Place(np.array([0.0, 0.0, value])) if joint.slides else Place(axes=turn)
        here = here.then(joint.place).then(moved)
        found.append(here)
    return [*found, here.then(chain.tip)]


def assert_at(place: Place, expected: np.ndarray) -> None:
    """Compare a frame with a matrix (4, 4), m."""
    np.testing.assert_allclose(place.position, 1e3 * expected[:3, 3], rtol=0.0, atol=NANOMETRE)
    np.testing.assert_allclose(place.axes, expected[:3, :3], rtol=0.0, atol=1e-12)


# --- URDF ------------------------------------------------------------------------------------------------------------


def test_a_shipped_arm_stands_where_its_file_says(rng):
    chain = read_urdf(PANDA, tip="ball_link")
    names = [one.name for one in chain.joints]
    assert names == [f"panda_joint{k}" for k in range(1, 8)]
    low, high = np.array([one.ends for one in chain.joints]).T
    np.testing.assert_array_equal(low[[0, 3]], [-2.8973, -3.0718])
    for q in rng.uniform(low, high, (10, 7)):
        links = place_links(PANDA.read_text(), dict(zip(names, q, strict=True)))
        *moved, tip = follow(chain, q)
        assert_at(tip, links["ball_link"])
        for k, place in enumerate(moved, start=1):
            assert_at(place.then(chain.joints[k - 1].link), links[f"panda_link{k}"])


def test_joints_that_slide_axes_and_fixed_joints(tmp_path, rng):
    chain = read_urdf(write_small(tmp_path))
    assert [(one.name, one.slides) for one in chain.joints] == [("turn", False), ("lift", True), ("spin", False)]
    assert [one.ends for one in chain.joints] == [(-1.2, 2.0), (-100.0, 350.0), (-np.inf, np.inf)]
    for q in rng.uniform(-1.0, 1.0, (10, 3)) * [1.0, 300.0, 3.0]:
        links = place_links(SMALL, dict(zip(JOINTS, q * [1.0, 1e-3, 1.0], strict=True)))
        *moved, tip = follow(chain, q)
        assert_at(tip, links["flange"])
        for place, joint, link in zip(moved, chain.joints, ("column", "slide", "hand"), strict=True):
            assert_at(place.then(joint.link), links[link])


def test_a_joint_carries_what_is_fixed_to_its_link(tmp_path, rng):
    chain, masses = read_urdf(write_small(tmp_path)), list_masses(SMALL)
    q = np.array([0.7, 120.0, -1.1])
    links = place_links(SMALL, dict(zip(JOINTS, q * [1.0, 1e-3, 1.0], strict=True)))
    for place, joint, carried in zip(
        follow(chain, q), chain.joints, (("column", "motor"), ("slide",), ("hand", "flange")), strict=False
    ):
        total = sum(masses[one][0] for one in carried)
        centre = sum(masses[one][0] * (links[one] @ masses[one][1]) for one in carried)[:3] / total
        assert joint.mass == pytest.approx(total, rel=1e-14)
        at = place.position + place.axes @ joint.centre
        np.testing.assert_allclose(at, 1e3 * centre, rtol=0.0, atol=NANOMETRE)


def test_a_chain_runs_between_links_that_are_named(tmp_path, rng):
    chain = read_urdf(write_small(tmp_path), base="column", tip="hand")
    assert [one.name for one in chain.joints] == ["lift", "spin"]
    links = place_links(SMALL, {"lift": 0.2, "spin": 0.4})
    assert_at(follow(chain, [200.0, 0.4])[-1], np.linalg.inv(links["column"]) @ links["hand"])


# --- Denavit and Hartenberg ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("modified", [False, True])
def test_rows_are_the_product_of_textbooks(modified, rng):
    rows = [DenavitRow(*x) for x in rng.uniform(-1.0, 1.0, (6, 4)) * [300.0, 400.0, 3.0, 3.0]]
    tip = Place(np.array([10.0, -20.0, 130.0]), np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]))
    names = [Joint(f"j{k}", Place()) for k in range(6)]
    chain = chain_rows(rows, names, modified, tip)
    for q in rng.uniform(-3.0, 3.0, (5, 6)):
        product = np.eye(4)
        for row, value in zip(rows, q, strict=True):
            product = product @ multiply(row.d, row.a, row.alpha, row.theta + value, modified)
        found = follow(chain, q)[-1]
        np.testing.assert_allclose(found.position, product[:3, :3] @ tip.position + product[:3, 3], atol=NANOMETRE)
        np.testing.assert_allclose(found.axes, product[:3, :3] @ tip.axes, atol=1e-12)


# --- files that are none ---------------------------------------------------------------------------------------------

LIMIT = '<limit lower="-1.2" upper="2.0"'
FAULTS = {
    "broken chain": ('<child link="slide"/>', '<child link="loose"/>', "line 25: joint 'lift': found no link 'loose'"),
    "mimic": (
        '<axis xyz="0 0 -1"/>',
        '<axis xyz="0 0 -1"/><mimic joint="turn"/>',
        "found a joint that mimics another",
    ),
    "floating": (
        '"continuous"',
        '"floating"',
        "line 30: joint 'spin': found type 'floating', expected one of revolute",
    ),
    "no type": (' type="continuous"', "", "line 30: joint 'spin': found type '', expected one of revolute"),
    "two above": ('<child link="flange"/>', '<child link="hand"/>', "line 34: link 'hand': found two joints above it"),
    "no robot": ("robot", "machine", "line 2: found <machine>, expected <robot>"),
    "xacro": (
        '<link name="floor"/>',
        "<xacro:arm/>",
        "line 3: found <xacro:arm>, expected URDF: bayescal init expands it",
    ),
    "type": ('<?xml version="1.0"?>', "<!DOCTYPE robot [<!ENTITY a 'b'>]>", "line 1: found a document type"),
    "text": ('xyz="0.4 0 0"', 'xyz="0.4 0 much"', "line 31: xyz: found '0.4 0 much', expected 3 numbers"),
    "two": ('rpy="1.5 0 -0.2"', 'rpy="1.5 0"', "line 31: rpy: found '1.5 0', expected 3 numbers"),
    "nan": ('value="0.7"', 'value="nan"', "line 11: value: found 'nan', expected a number"),
    "less than nothing": ('value="0.7"', 'value="-0.7"', "line 11: mass: found -0.7 kg, expected none below zero"),
    "millimetres": ('xyz="0.4 0 0"', 'xyz="500 0 0"', "line 31: xyz: found 500 m, expected metres"),
    "far": ('xyz="0.4 0 0"', 'xyz="1e308 0 0"', "line 31: xyz: found '1e308 0 0', expected 3 numbers"),
    "limits": (LIMIT, '<limit lower="2.0" upper="-1.2"', "line 20: limit: found 2 to -1.2, expected the smaller first"),
    "axis": ('xyz="0 2 2"', 'xyz="0 0 0"', "line 16: joint 'turn': axis: found zero, expected a direction"),
    "no parent": ('<parent link="slide"/>', "", "line 30: joint 'spin': found no parent, expected a link"),
    "end": ("</robot>", "", "line 42: no element found, expected XML"),
    "encoding": (
        'version="1.0"',
        'version="1.0" encoding="unheard-of"',
        "line 1: unknown encoding: unheard-of, expected XML in UTF-8",
    ),
    "wide": ('version="1.0"', 'version="1.0" encoding="utf-32"', "expected XML"),
    "without limits": (
        '<limit lower="-0.1" upper="0.35" effort="50" velocity="1"/>',
        "",
        "joint 'lift': found no limit",
    ),
    "twice": ('joint name="lift"', 'joint name="turn"', "line 25: found a second joint 'turn', expected unique names"),
    "same link": ('link name="motor"', 'link name="slide"', "line 10: found a second link 'slide', expected unique"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_file_that_holds_no_chain_is_refused_in_a_line(tmp_path, name):
    old, new, said = FAULTS[name]
    assert old in SMALL
    line = line_of(read_urdf, write_small(tmp_path, SMALL.replace(old, new)))
    assert "small.urdf" in line
    assert said in line


@pytest.mark.parametrize(
    ("base", "tip", "said"),
    [
        ("", "thumb", "tip: found no link 'thumb', expected one of floor, plinth"),
        ("cellar", "", "base: found no link 'cellar', expected one of floor, plinth"),
        ("hand", "column", "found no chain from link 'hand' to 'column', which is below 'floor'"),
        ("hand", "flange", "found no moving joint from base to tip, expected at least one"),
    ],
)
def test_links_that_no_chain_joins_are_refused(tmp_path, base, tip, said):
    assert said in line_of(read_urdf, write_small(tmp_path), base, tip)


def test_a_ring_of_joints_has_no_base(tmp_path):
    path = write_small(tmp_path, SMALL.replace('<parent link="floor"/>', '<parent link="flange"/>'))
    assert "found no chain from link 'floor' to 'flange'" in line_of(read_urdf, path, "", "flange")


def test_several_leaves_are_named(tmp_path):
    assert "tip: missing, expected one of " in line_of(read_urdf, PANDA)
    assert "No such file" in line_of(read_urdf, tmp_path / "nowhere.urdf")


JUNK = st.one_of(
    st.sampled_from(
        [
            "",
            "nan",
            "inf",
            "-0",
            "0",
            "1e308",
            "-1e308",
            "1e-308",
            "1_0",
            "0 0 0",
            "<",
            ">",
            "/>",
            "</robot>",
            "<!--",
            "&a;",
        ]
    ),
    st.sampled_from(["revolute", "prismatic", "fixed", "floor", "hand", "turn", "<link/>", "<joint/>", "<origin/>"]),
    st.text(st.characters(codec="utf-8", exclude_characters="\r"), max_size=5),
)
PIECES = [one.span() for one in re.finditer(r"[^\s<>=\"]+", SMALL)]


@given(st.lists(st.tuples(st.sampled_from(PIECES), JUNK, st.booleans()), min_size=1, max_size=3))
@example([((SMALL.index("0 2 2"), SMALL.index("0 2 2") + 5), "1e308 1e308 0", False)])
@example([((SMALL.index("0 2 2"), SMALL.index("0 2 2") + 5), "1e-308 0 0", False)])
@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_file_is_a_chain_or_one_line(tmp_path, changes):
    text = SMALL
    for (start, end), junk, beside in sorted(changes, reverse=True):
        text = text[: end if beside else start] + junk + text[end:]
    path = write_small(tmp_path, text)
    try:
        chain = read_urdf(path)
    except InputError as error:
        said = str(error)
        assert "\n" not in said
        assert "small.urdf" in said
        return
    for joint in chain.joints:
        assert np.isfinite([*joint.place.position, *joint.centre, joint.mass]).all()
        np.testing.assert_allclose(joint.place.axes.T @ joint.place.axes, np.eye(3), atol=1e-9)
