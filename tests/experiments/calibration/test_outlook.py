"""Audits in the units asked for: the words and numbers change, and nothing that is computed."""

import html

import calibrations
import numpy as np
import pytest

from bayescal.experiments.runner.load import load
from bayescal.experiments.runner.run import run_experiment
from bayescal.report.symbols import format_amount, format_place, shown_in

NO_ERROR = "[model_error]\nterms = []\n"  # whose sizes are in µm whatever the units
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
        path.write_text(text.replace("[sensors]", f"{NO_ERROR}{units}[sensors]"))
        done = run_experiment(load(path)[1], folder, folder / "out", quiet=True)
        return done.results, html.unescape((folder / "out" / "report.html").read_text()).replace("\xa0", " ")

    return run_in


def test_units_asked_for_change_the_words_and_nothing_else(run):
    (plain, first), (other, second) = run(""), run(UNITS)
    mine, same = (one.table("requirements").set_index(["variant", "requirement"]) for one in (plain, other))
    np.testing.assert_allclose(1e3 * mine["rms_sd"], same["rms_sd"], rtol=1e-6)
    np.testing.assert_allclose(mine["probability"], same["probability"])
    assert set(same["unit"]) == {"um"}
    assert " µm" in second
    assert " µm" not in first.partition("Ridges")[0]


def test_values_are_shown_in_the_units_of_the_config():
    asked = {"length": "m", "angle": "deg"}
    assert format_amount(np.radians(0.5), "rad", 2, asked) == "0.50°"
    assert format_amount(1250.0, "mm", 3, asked) == "1.25 m"
    assert format_place("phi_rad", np.radians(12.34), asked) == "12.3"
    assert shown_in("K", asked) == (1.0, "K")
    assert shown_in("rad") == (np.degrees(1.0), "°")
