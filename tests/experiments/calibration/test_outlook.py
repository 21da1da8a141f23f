"""How requirements stand: shares of drawn machines against closed forms; pages in the units asked for."""

import html

import calibrations
import numpy as np
import pytest
from scipy.stats import norm

from bayescal.experiments.audit.outlook import foresee
from bayescal.experiments.frame.load import load
from bayescal.experiments.frame.run import run_experiment
from bayescal.identifiability.reading_rows import View
from bayescal.report.units import format_amount, format_place, shown_in


def view(tool, located):
    """Return poses with slopes of the tool (W, t, m) and roots of its noise (W, t, K)."""
    n = len(tool)
    return View(
        np.arange(n, dtype=float)[:, None], np.zeros((n, 1, tool.shape[2])), tool, (located**2).sum(-1), located
    )


def test_a_machine_that_errs_alike_everywhere_keeps_its_limit_as_a_normal_deviate_does():
    tool, located = np.full((30, 1, 1), 0.2), np.zeros((30, 1, 1))
    sd = 0.2 * 0.5
    for limit in (0.05, 0.1, 0.2):
        found = foresee(view(tool, located), np.array([[0.25]]), np.array([limit]), np.random.default_rng(1))
        share = 2.0 * norm.cdf(limit / sd) - 1.0
        error = 4.0 * np.sqrt(share * (1.0 - share) / 2000)
        assert abs(found.probability[0] - share) < error
        assert abs(found.before[0] - (2.0 * norm.cdf(limit / 0.2) - 1.0)) < 4.0 * np.sqrt(0.25 / 2000)
        assert found.everywhere[0] == found.probability[0] == found.together
        np.testing.assert_allclose(found.worst, sd)


def test_noise_alone_keeps_an_rms_limit_that_single_poses_exceed():
    found = foresee(
        view(np.zeros((40, 2, 3)), np.broadcast_to(0.1 * np.eye(2), (40, 2, 2))),
        0.1 * np.eye(3),
        np.array([0.2, np.inf]),
        np.random.default_rng(2),
    )
    share = (2.0 * norm.cdf(2.0) - 1.0) ** 40
    assert abs(found.everywhere[0] - share) < 4.0 * np.sqrt(share * (1.0 - share) / 2000)
    np.testing.assert_array_equal(found.probability, 1.0)
    assert found.everywhere[1] == 1.0


def test_the_worst_pose_is_where_the_tool_errs_most():
    tool = np.linspace(0.1, 0.3, 7)[:, None, None] * [[[1.0, 0.0], [0.0, -1.0]]]
    found = foresee(view(tool, np.zeros((7, 2, 1))), np.diag([1.0, 4.0]), np.full(2, 1.0), np.random.default_rng(3))
    np.testing.assert_allclose(found.worst, [0.3, 0.6])
    np.testing.assert_array_equal(found.worst_pose, [[6.0], [6.0]])


def test_what_is_not_told_has_no_probability():
    tool = np.full((5, 1, 2), np.nan)
    found = foresee(view(tool, np.zeros((5, 1, 1))), np.eye(2), np.ones(1), np.random.default_rng(4))
    assert np.isnan([found.together, found.probability[0], found.worst[0]]).all()


UNITS = '[units]\nlength = "um"\nangle = "arcsec"\n'


@pytest.fixture
def run(tmp_path, no_pictures):
    """Return a function that runs the audit in the units of a config: the results, the page's words."""

    def run_in(units):
        inner = tmp_path / f"in{len(units)}"
        inner.mkdir()
        folder = calibrations.write_audit(inner).parent
        path = folder / "audit.toml"
        factor = 1000 if units else 1
        text = path.read_text().replace("x = 0.05, y = 0.05, z = 0.03", f"x = {0.05 * factor}, z = {0.03 * factor}")
        if units:
            for old, new in (("sd = 0.5", "sd = 500.0"), ("sd = 0.3", "sd = 300.0"), ("sd = 0.1", "sd = 360.0")):
                text = text.replace(old, new)
        path.write_text(text.replace("[sensors]", f"{units}[sensors]"))
        done = run_experiment(load(path)[1], folder, folder / "out", quiet=True)
        return done.results, html.unescape((folder / "out" / "report.html").read_text()).replace("\xa0", " ")

    return run_in


def test_units_asked_for_change_the_words_and_no_number(run):
    (plain, first), (other, second) = run(""), run(UNITS)
    mine, same = (one.table("requirements").select_dtypes("number") for one in (plain, other))
    np.testing.assert_allclose(mine, same, rtol=1e-6)
    errors = mine["error"].to_numpy()
    assert f"z errs by {format_amount(errors[1], 'mm', 3)} rms, 0.0300 mm allowed" in first
    assert f"z errs by {1e3 * errors[1]:.1f} µm rms, 30.0 µm allowed" in second
    together = plain.table("variants")["probability"][0]
    assert f"all of it with {100 * together:.0f} % probability" in first
    row = plain.table("requirements").iloc[1]
    assert row["worst"] > row["error"]
    assert 0.0 <= row["probability_before"] < 0.5 < together <= row["probability"] < 1.0
    assert row["probability_everywhere"] < row["probability"]


def test_values_are_shown_in_the_units_of_the_config():
    asked = {"length": "m", "angle": "deg"}
    assert format_amount(np.radians(0.5), "rad", 2, asked) == "0.50°"
    assert format_amount(1250.0, "mm", 3, asked) == "1.25 m"
    assert format_place("phi_rad", np.radians(12.34), asked) == "12.3"
    assert shown_in("K", asked) == (1.0, "K")
    assert shown_in("rad") == (np.degrees(1.0), "°")
