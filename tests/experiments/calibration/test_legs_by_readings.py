"""The M2 hexapod's study by tables of readings: as a mechanism on legs, and as a class that knows nothing of legs."""

import numpy as np
import pytest
import studies
from telescope_machines import list_coordinates

from bayescal.experiments.runner.load import load
from bayescal.experiments.shared.readings.inputs import read_inputs
from bayescal.experiments.study.inputs import StudyInputs
from bayescal.inference.exploration import integrate_posterior
from bayescal.inference.importance import resample
from bayescal.inference.schema import EvidenceConfig
from bayescal.machines.readings import POSE

STUDY = studies.EXPERIMENTS / "m2_hexapod" / "lengths.toml"
MECHANISM = studies.EXPERIMENTS / "audit" / "m2_hexapod_mechanism.toml"
LEGS = 'kind = "legs"\nname = "m2"\nmechanism = "mechanism.toml"\nmodel = "six_ups"\n'
OWN = 'kind = "struts.py:Struts"\nname = "m2"\n'
CLASS = """
import numpy as np

from bayescal.machines.parameters import ParameterBlock
from bayescal.machines.readings import Channel, Coordinate, ReadingMachine
from bayescal.numerics.analytic import norm, rotation_matrix

BASE, PLATFORM = np.array({base}), np.array({platform})
HOME, LENGTHS = np.array({home}), {lengths}


class Struts(ReadingMachine):
    def __init__(self, config):
        self.parameters = [ParameterBlock("l", tuple(LENGTHS))]
        units = ("mm",) * 3 + ("rad",) * 3
        names = ("x", "y", "z", "rx", "ry", "rz")
        half = (30.0,) * 3 + (0.02,) * 3
        self.coordinates = [Coordinate(n, u, h, r) for n, u, h, r in zip(names, units, [*HOME, 0.0, 0.0, 0.0], half)]
        self.channels = [Channel(f"rho[{{k + 1}}]", "mm") for k in range(6)] + [
            Channel(n, u, external=True, rotation="r" if u == "rad" else "") for n, u in zip(names, units)
        ]

    def read(self, parameters, v, given):
        joints = v[..., None, :3] + np.einsum("...ij,kj->...ki", rotation_matrix(v[..., 3:]), PLATFORM)
        rho = norm(joints - BASE) - parameters["l"]
        shape = np.broadcast_shapes(rho.shape[:-1], v.shape[:-1])
        return np.concatenate([np.broadcast_to(one, (*shape, 6)) for one in (rho, v)], axis=-1)
"""
CONFIG = """
kind = "study"
name = "m2_by_readings"
title = "The M2 hexapod by the general route"
seed = 2026
machine = "machine.toml"

[provenance]
status = "simulated"
text = "the study's twin"

[[data]]
file = "readings.csv"
commanded_channels = ["rho"]

[sensors]
{legs}
{pose}

[parameters]
l = {{ prior = "normal", sd = 1.0 }}

[model_error]
{errors}

[[variants]]
name = "lengths"
title = "Lengths free"
"""


@pytest.fixture(scope="module")
def study():
    return StudyInputs.load(load(STUDY)[1], STUDY.parent)


def write_readings(poses):
    """Return the table of measured poses and their actuators."""
    units = ["mm"] * 3 + ["rad"] * 3
    pairs = [(i, j) for i in range(6) for j in range(i + 1, 6)]
    columns = ["pose", *(f"rho_{k + 1}_mm" for k in range(6))]
    columns += [f"{name}{sd}_{unit}" for sd in ("", "_sd") for name, unit in zip(POSE, units, strict=True)]
    columns += [f"corr_{POSE[i]}_{POSE[j]}" for i, j in pairs]
    lines = [",".join(columns)]
    covariances = np.broadcast_to(poses.covariance, (poses.n_poses, 6, 6))
    for name, rho, pose, covariance in zip(
        poses.names, poses.actuators, list_coordinates(poses), covariances, strict=True
    ):
        sd = np.sqrt(np.diag(covariance))
        correlation = covariance / np.outer(sd, sd)
        numbers = [*rho, *pose, *sd, *(correlation[one] for one in pairs)]
        lines.append(",".join([name, *(repr(float(x)) for x in numbers)]))
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="module", params=["legs", "class"])
def general(request, study, tmp_path_factory):
    """Return the posterior of the same data by the general route."""
    folder, mechanism = tmp_path_factory.mktemp(request.param), study.pads.mechanism
    legs = [f'"rho[{k}]" = {{ noise_um = 1.0, noise_group = "leg_{k}" }}' for k in range(1, 7)]
    text = CONFIG.format(
        legs="\n".join(legs),
        pose="\n".join(f"{name} = {{ noise_{'mm' if len(name) == 1 else 'rad'} = 1.0 }}" for name in POSE),
        errors="\n".join(f"leg_{k} = {{ scale = 0.01 }}" for k in range(1, 7)),
    )
    (folder / "study.toml").write_text(text)
    (folder / "readings.csv").write_text(write_readings(study.measured[0].poses.select(~study.verification)))
    (folder / "machine.toml").write_text(LEGS if request.param == "legs" else OWN)
    (folder / "mechanism.toml").write_text(MECHANISM.read_text())
    known = {
        "base": mechanism.base_points.tolist(),
        "platform": mechanism.platform_points.tolist(),
        "home": study.variants["six_ups/none"].whole.home_pose[:3].tolist(),
        "lengths": mechanism.leg_lengths.tolist(),
    }
    (folder / "struts.py").write_text(CLASS.format(**known))
    inputs = read_inputs(load(folder / "study.toml")[1], folder)
    return inputs.variants["lengths"].posterior().with_pose_guesses()


@pytest.fixture(scope="module")
def fast(study):
    return study.variants["six_ups/none"].posterior().with_pose_guesses()


def test_density_of_the_same_parameters_is_the_same(fast, general):
    """Priors are the same by symbol and by leg."""
    mode = fast.refine_geometry(fast.least_squares_start())
    y = mode + 0.003 * np.random.default_rng(2).standard_normal((6, len(mode)))
    natural, other = fast.natural(y), to_general(fast, general, y)
    np.testing.assert_allclose(general.natural(other), natural, atol=1e-9)
    expected = fast.pointwise(y).sum(axis=1)
    np.testing.assert_allclose(general.pointwise(other).sum(axis=1), expected, atol=0.02)


def to_general(fast, general, y):
    """Return coordinates of the general posterior where parameters and model errors are those of the other at y."""
    theta = np.tile(general.sampling.start, (len(y), 1))
    theta[:, general.likelihood.model.layout.index["l"]] = fast.natural(y)[:, :6]
    return general.to_coordinates(theta, y[:, 6:])


def integrate(posterior):
    """Return the evidence with its standard error, draws (S, n) in the posterior's own coordinates."""
    seeds = np.random.SeedSequence(28).spawn(2)
    explored, evidence = integrate_posterior(
        posterior, *seeds, 64, EvidenceConfig(draws=4000, tolerance_nat=0.008, max_draws=12000)
    )
    rng = np.random.default_rng(1)
    drawn = resample(explored.straight.log_density, explored.proposal, rng, 12000, 4000).draws
    return evidence, explored.straight.y_from_x(drawn)


@pytest.mark.runs
def test_posterior_and_evidence_are_those_of_the_study(fast, general):
    """Means within 0.1 posterior standard deviations and evidence within 0.03 nats, by weights of the study's draws."""
    _, y = integrate(fast)
    y = y[:1000]
    weights = np.exp(general.log_density(to_general(fast, general, y)) - fast.log_density(y))
    assert abs(np.log(weights.mean())) < 0.03
    natural = fast.natural(y)
    moved = (weights[:, None] * natural).sum(axis=0) / weights.sum() - natural.mean(axis=0)
    assert (np.abs(moved) < 0.1 * natural.std(axis=0)).all()


@pytest.mark.slow
def test_search_of_the_general_route_finds_the_same(fast, general):
    """Its own mode, proposal and draws, as efficient as those of the study: legs' errors make the same funnel."""
    (one, y), (other, its) = integrate(fast), integrate(general)
    assert other.log_evidence == pytest.approx(one.log_evidence, abs=0.03)
    assert other.efficiency > 0.8 * one.efficiency
    natural, found = fast.natural(y), general.natural(its)
    assert (np.abs(found.mean(axis=0) - natural.mean(axis=0)) < 0.1 * natural.std(axis=0)).all()
    np.testing.assert_allclose(found.std(axis=0), natural.std(axis=0), rtol=0.1)
