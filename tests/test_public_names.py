"""What `import bayescal` offers is there and documented."""

import inspect

import pytest

import bayescal

PROMISED = {"sample_posterior", "solve_inverse_kinematics", "StudyInputs", "tabulate_jacobian", "run_experiment"}


@pytest.mark.parametrize("name", bayescal.__all__)
def test_public_name_is_there_and_documented(name):
    assert inspect.getdoc(getattr(bayescal, name))


def test_promised_names_are_public():
    assert set(bayescal.__all__) >= PROMISED
    assert set(dir(bayescal)) == set(bayescal.__all__)
