"""A mount's eight terms: their formula, both ways of counting azimuth, a measured telescope against least squares."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
import studies

from bayescal.experiments.runner.load import load_experiment
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.inference.mode import find_modes
from bayescal.machines.readings.mount import TERMS, Mount, MountConfig

MMT = studies.EXPERIMENTS / "mmt_mount"
ARCSECOND = np.pi / 648_000.0


def correct(term, azimuth, elevation):
    """Return what a pointing program adds to encoders, azimuths counted from south, for (P,) directions."""
    ia, ie, an, aw, ca, npae, tf, tx = term
    across = -ia - (an * np.sin(azimuth) + aw * np.cos(azimuth) + npae) * np.tan(elevation) - ca / np.cos(elevation)
    along = ie - an * np.cos(azimuth) + aw * np.sin(azimuth) - tf * np.cos(elevation) - tx / np.tan(elevation)
    return across, along


@pytest.mark.parametrize("start", ["south", "north"])
def test_encoders_read_the_sky_less_the_correction(start, rng):
    mount = Mount(MountConfig(azimuth_from=start))
    term, azimuth, elevation = 1e-3 * rng.standard_normal(8), rng.uniform(-3, 3, 20), rng.uniform(0.3, 1.4, 20)
    sky = azimuth if start == "south" else np.pi - azimuth
    read = mount.read(dict(zip(TERMS, term, strict=True)), np.stack([sky, elevation], axis=-1), {})
    across, along = correct(term, azimuth, elevation)
    turned = (read[:, 0] if start == "south" else np.pi - read[:, 0]) - azimuth
    np.testing.assert_allclose(turned, -across, atol=1e-12)
    np.testing.assert_allclose(read[:, 1] - elevation, -along, atol=1e-12)
    np.testing.assert_allclose(read[:, 2:], np.stack([sky, elevation], axis=-1))


@pytest.mark.parametrize(
    ("ends", "said"),
    [
        ({"azimuth_deg": [10.0, 10.0]}, "azimuth_deg: found 10 to 10, expected the smaller first"),
        ({"elevation_deg": [0.0, 80.0]}, "elevation_deg: found 0 to 80, expected ends between 0 and 90"),
        ({"elevation_deg": [20.0, 90.0]}, "elevation_deg: found 20 to 90, expected ends between 0 and 90"),
    ],
)
def test_ends_that_are_none_are_refused(ends, said):
    with pytest.raises(ValueError, match=said):
        Mount(MountConfig(**ends))


def test_a_measured_telescope_has_the_terms_of_least_squares():
    table = pd.read_csv(MMT / "data" / "stars.csv", comment="#")
    azimuth, elevation, *encoder = np.radians(table.drop(columns="pose").to_numpy().T)
    across = (azimuth - encoder[0] + np.pi) % (2.0 * np.pi) - np.pi
    slopes = [np.stack(part) for part in zip(*(correct(one, azimuth, elevation) for one in np.eye(8)), strict=True)]
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
    for k, name in enumerate(TERMS):
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
