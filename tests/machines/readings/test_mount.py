"""A mount's terms: their formulas, as small rotations, both ways of counting azimuth, a measured telescope."""

from __future__ import annotations

import shutil

import numpy as np
import pandas as pd
import pytest
import studies

from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.inference.mode import find_modes
from bayescal.machines.readings.mount import ALTAZIMUTH, TERMS, Mount, MountConfig
from bayescal.numerics.analytic import rotation_matrix

MMT = studies.EXPERIMENTS / "mmt_mount"
ARCSECOND = np.pi / 648_000.0
EQUATORIAL, LATITUDE = "equatorial", np.radians(-31.7)


def correct(term, azimuth, elevation):
    """Return what a pointing program adds to encoders, azimuths from north through east, for (P,) directions."""
    ia, ie, an, aw, ca, npae, tf, tx = term
    across = -ia - (an * np.sin(azimuth) + aw * np.cos(azimuth) + npae) * np.tan(elevation) - ca / np.cos(elevation)
    along = ie - an * np.cos(azimuth) + aw * np.sin(azimuth) - tf * np.cos(elevation) - tx / np.tan(elevation)
    return across, along


def correct_hours(term, h, d):
    """Return the same for hour angles and declinations (P,), term by term as the program lists them."""
    ih, id_, np_, ch, me, ma, tf, fo, daf = term
    c, s = np.cos(LATITUDE), np.sin(LATITUDE)
    across = ih + np_ * np.tan(d) + ch / np.cos(d) + me * np.sin(h) * np.tan(d) - ma * np.cos(h) * np.tan(d)
    across += tf * c * np.sin(h) / np.cos(d) - daf * (c * np.cos(h) + s * np.tan(d))
    along = id_ + me * np.cos(h) + ma * np.sin(h) + fo * np.cos(h)
    return across, along + tf * (c * np.cos(h) * np.sin(d) - s * np.cos(d))


def build(axes, start="north"):
    """Return a mount of either kind."""
    own = {"azimuth_from": start} if axes == ALTAZIMUTH else {"latitude_deg": np.degrees(LATITUDE)}
    return Mount(MountConfig(axes=axes, **own))


def find_correction(axes, one, other, **terms):
    """Return what the sky is beyond the encoders at directions (P,)."""
    every = dict.fromkeys(TERMS[axes], 0.0) | terms
    read = build(axes).read(every, np.stack([one, other], axis=-1), {})
    return one - read[:, 0], other - read[:, 1]


@pytest.mark.parametrize("start", ["south", "north"])
def test_encoders_read_the_sky_less_the_correction(start, rng):
    term, azimuth, elevation = 1e-3 * rng.standard_normal(8), rng.uniform(-3, 3, 20), rng.uniform(0.3, 1.4, 20)
    terms = dict(zip(TERMS[ALTAZIMUTH], term, strict=True))
    read = build(ALTAZIMUTH, start).read(terms, np.stack([azimuth, elevation], axis=-1), {})
    across, along = correct(term, azimuth, elevation)
    np.testing.assert_allclose(read[:, 0] - azimuth, -across, atol=1e-12)
    np.testing.assert_allclose(read[:, 1] - elevation, -along, atol=1e-12)
    np.testing.assert_allclose(read[:, 2:], np.stack([azimuth, elevation], axis=-1))


def test_encoders_of_hour_angle_and_declination_read_the_sky_less_the_correction(rng):
    term, hour, declination = 1e-3 * rng.standard_normal(9), rng.uniform(-1.5, 1.5, 20), rng.uniform(-1.2, 1.2, 20)
    found = find_correction(EQUATORIAL, hour, declination, **dict(zip(TERMS[EQUATORIAL], term, strict=True)))
    np.testing.assert_allclose(found, correct_hours(term, hour, declination), atol=1e-12)


SMALL = 1e-6  # rad, whose square is 1e-12


def point(axes, one, other):
    """Return directions (P, 3): axes east, north and up; or the meridian's equator, east and the pole."""
    first = np.pi / 2 - one if axes == ALTAZIMUTH else -one
    return np.stack([np.cos(other) * np.cos(first), np.cos(other) * np.sin(first), np.sin(other)], axis=-1)


@pytest.mark.parametrize(
    ("axes", "name", "pole"),
    [
        (ALTAZIMUTH, "AN", [0.0, 1.0]),  # to the north
        (ALTAZIMUTH, "AW", [-1.0, 0.0]),  # to the west
        (EQUATORIAL, "ME", [-1.0, 0.0]),  # away from the zenith
        (EQUATORIAL, "MA", [0.0, 1.0]),  # to the east
    ],
)
def test_a_tilted_axis_is_a_rotation_of_the_mount(axes, name, pole, rng):
    one, other = rng.uniform(-1.2, 1.2, 30), rng.uniform(0.2, 1.2, 30)
    across, along = find_correction(axes, one, other, **{name: SMALL})
    tilt = rotation_matrix(SMALL * np.array([-pole[1], pole[0], 0.0]))  # takes the pole to where it leans
    seen = point(axes, one - across, other - along) @ tilt.T  # encoders' direction, carried by the tilted mount
    np.testing.assert_allclose(seen, point(axes, one, other), atol=1e-11)


@pytest.mark.parametrize(("axes", "square", "tube"), [(ALTAZIMUTH, "NPAE", "CA"), (EQUATORIAL, "NP", "CH")])
def test_axes_and_tube_that_are_not_square_are_rotations_by_tilted_axes(axes, square, tube, rng):
    one, other = rng.uniform(-1.2, 1.2, 30), rng.uniform(0.2, 1.2, 30)
    level, up = point(axes, one, np.zeros(30)), np.array([0.0, 0.0, 1.0])
    side = np.cross(up, level)  # the second axis: to the left of where the tube points, or to the east
    sign = 1.0 if axes == ALTAZIMUTH else -1.0  # positive to the left, or to the west
    for name, about in ((square, -level), (tube, np.cross(point(axes, one, other), side))):
        across, along = find_correction(axes, one, other, **{name: SMALL})
        turned = [rotation_matrix(sign * SMALL * own) for own in about]
        seen = np.einsum("pij,pj->pi", turned, point(axes, one, other))
        np.testing.assert_allclose(seen, point(axes, one + across, other + along), atol=1e-11)


def test_flexure_lowers_the_tube_by_the_sine_of_the_zenith_distance(rng):
    hour, declination = rng.uniform(-1.2, 1.2, 30), rng.uniform(-1.2, 0.9, 30)
    zenith = np.array([np.cos(LATITUDE), 0.0, np.sin(LATITUDE)])
    across, along = find_correction(EQUATORIAL, hour, declination, TF=SMALL)
    before, after = (
        np.arccos(point(EQUATORIAL, *at) @ zenith) for at in ((hour, declination), (hour + across, declination + along))
    )
    np.testing.assert_allclose(after - before, SMALL * np.sin(before), atol=1e-11)


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"azimuth_deg": [10.0, 10.0]}, "azimuth_deg: found 10 to 10, expected the smaller first"),
        ({"elevation_deg": [0.0, 80.0]}, "elevation_deg: found 0 to 80, expected ends between 0 and 90"),
        ({"elevation_deg": [20.0, 90.0]}, "elevation_deg: found 20 to 90, expected ends between 0 and 90"),
        ({"latitude_deg": 31.0}, "latitude_deg: found with axes 'altazimuth', expected none"),
        ({"axes": "equatorial"}, "latitude_deg: missing, expected that of the equatorial mount"),
        ({"axes": "equatorial", "latitude_deg": 3.0, "azimuth_from": "south"}, "azimuth_from: found with axes 'equa"),
        ({"axes": "equatorial", "latitude_deg": 3.0, "declination_deg": [-95.0, 9.0]}, "expected ends between -90 and"),
    ],
)
def test_sections_that_make_no_sense_are_refused(keys, said):
    with pytest.raises(ValueError, match=said):
        Mount(MountConfig(**keys))


def test_a_measured_telescope_has_the_terms_of_least_squares():
    table = pd.read_csv(MMT / "data" / "stars.csv", comment="#")
    azimuth, elevation, *encoder = np.radians(table.drop(columns="pose").to_numpy().T)
    across = (azimuth - encoder[0] + np.pi) % (2.0 * np.pi) - np.pi
    columns = zip(*(correct(one, azimuth, elevation) for one in np.eye(8)), strict=True)  # as counted, from south
    slopes = [np.stack(part) for part in columns]
    inputs = StudyInputs.load(load_experiment(MMT / "study.toml"), MMT)
    posterior = inputs.variants["eight"].posterior().with_pose_guesses()
    (mode,) = find_modes(posterior)
    found = dict(zip(posterior.names, posterior.natural(mode.y[None])[0], strict=True))
    factors = [found["noise_factor(azimuth_axis)"] * 2.0, found["noise_factor(elevation_axis)"]]
    rows = np.concatenate([one.T / factor for one, factor in zip(slopes, factors, strict=True)])
    left = np.concatenate([across / factors[0], (elevation - encoder[1]) / factors[1]])
    terms, *_ = np.linalg.lstsq(rows, left)
    sd = ARCSECOND * np.sqrt(np.diag(np.linalg.inv(rows.T @ rows)))
    assert len(table) == 80
    for k, name in enumerate(TERMS[ALTAZIMUTH]):
        assert found[name] == pytest.approx(terms[k], abs=0.2 * sd[k])


@pytest.mark.runs
def test_a_measured_telescope_is_calibrated_as_shipped(call, tmp_path):
    """Rankings, residuals and coverage of the shipped study; terms that look alike over few elevations are named."""
    code, said, _ = call("run", MMT / "study.toml", "--out", tmp_path / "out", "--workers", 1)
    assert code == 0
    assert said.startswith("Use ")
    variants = pd.read_csv(tmp_path / "out" / "tables" / "variants.csv").set_index("variant")
    assert variants["converged"].all()
    assert variants.loc["no_tx", "log_evidence"] < variants["log_evidence"].max() - 20.0
    predicted = pd.read_csv(tmp_path / "out" / "tables" / "predictions.csv")
    inside = predicted["measured"].between(predicted["low"], predicted["high"])
    for _, own in inside.groupby([predicted["variant"], predicted["channel"]]):
        assert 0.8 < own.mean() < 0.97
    factors = pd.read_csv(tmp_path / "out" / "tables" / "parameters.csv").set_index(["variant", "parameter"])["mean"]
    assert 2.0 * factors["eight", "noise_factor(azimuth_axis)"] == pytest.approx(
        1.3, abs=0.2
    )  # arcsec, as least squares
    assert factors["eight", "noise_factor(elevation_axis)"] == pytest.approx(0.78, abs=0.1)


PEER = {
    "IA": (1210.24, 1.24),
    "IE": (-3.22, 0.34),
    "AN": (2.37, 0.14),
    "AW": (-10.40, 0.12),
    "CA": (-7.68, 2.46),
    "NPAE": (-1.92, 2.29),
    "TF": (20.39, 1.26),
    "TX": (-2.37, 0.49),
    "noise_factor(azimuth_axis)": (1.77 / 2.0, 0.23 / 2.0),
    "noise_factor(elevation_axis)": (0.82, 0.11),
}
"""Means and standard deviations of 8,000 draws of PyMC 5.28 (NUTS) from the same density, arcsec; of 42 stars."""


@pytest.mark.runs
def test_a_measured_telescope_has_the_posterior_of_another_library(call, tmp_path):
    shutil.copytree(MMT, tmp_path / "mount")
    table = tmp_path / "mount" / "data" / "stars.csv"
    comments = [line for line in table.read_text().splitlines() if line.startswith("#")]
    stars = pd.read_csv(table, comment="#", dtype=str)
    stars = stars[stars["azimuth_deg"].astype(float) > 0.0]
    table.write_text("\n".join([*comments, stars.to_csv(index=False)]))
    study = tmp_path / "mount" / "study.toml"
    text = study.read_text().partition("[[variants]]")[0]
    study.write_text(text + '[[variants]]\nname = "eight"\n\n[sampler]\neffort = "thorough"\n')
    code, *_ = call("run", study, "--out", tmp_path / "out", "--workers", 1)
    assert (code, len(stars)) == (0, 42)
    found = pd.read_csv(tmp_path / "out" / "tables" / "parameters.csv").set_index("parameter")
    assert set(PEER) == set(found.index)
    for name, (mean, sd) in PEER.items():
        unit = ARCSECOND if found.loc[name, "unit"] == "rad" else 1.0
        own = found.loc[name, "mean"] / unit
        assert own == pytest.approx(mean, abs=0.1 * sd + 0.005), name
        assert found.loc[name, "sd"] / unit == pytest.approx(sd, abs=0.05 * sd + 0.005), name  # of two digits
