"""A width of zero says that a member is known, and no noise needs no unit; no factor asks for no run."""

from __future__ import annotations

import pytest
from function_machines import point_on_lines
from pydantic import TypeAdapter, ValidationError

from bayescal.density.schema import PriorConfig
from bayescal.errors import InputError
from bayescal.experiments.shared.readings.noise import noise_of_channels
from bayescal.experiments.shared.readings.priors import choose_priors
from bayescal.experiments.shared.readings.schema import ChannelConfig, FreeConfig
from bayescal.experiments.shared.schema import UnitsConfig
from bayescal.experiments.shared.study_schema import SensitivityConfig

PRIOR = TypeAdapter(PriorConfig)


class Tolerances:
    units = UnitsConfig(length="mm", angle="deg")

    def __init__(self, **sections):
        self.parameters = {name: PRIOR.validate_python(one) for name, one in sections.items()}


@pytest.mark.parametrize(("prior", "key"), [("normal", "sd"), ("uniform", "half_width")])
def test_a_member_of_zero_width_is_known(prior, key):
    tolerances = Tolerances(zero={"prior": prior, key: [0.5, 0.5, 0.0]})
    layout = point_on_lines().layout
    for choice in (FreeConfig(), FreeConfig(free=["zero"])):
        priors, fixed, _ = choose_priors(tolerances, choice, layout)
        assert list(priors) == ["zero[1]", "zero[2]"]
        assert not fixed
    with pytest.raises(InputError, match=r"free: found 'zero\[3\]'"):
        choose_priors(tolerances, FreeConfig(free=["zero[3]"]), layout)
    with pytest.raises(InputError, match="tied"):
        choose_priors(tolerances, FreeConfig(tied=["zero"]), layout)


@pytest.mark.parametrize("sd", [0.0, [0.0, 0.0, 0.0], [0.5, -0.5, 0.0]])
def test_widths_that_are_none_are_refused(sd):
    with pytest.raises(ValidationError):
        Tolerances(zero={"prior": "normal", "sd": sd})


@pytest.mark.parametrize("value", [0, 0.0, [0.0, 0.0, 0.0]])
def test_no_noise_needs_no_unit(value):
    model = point_on_lines()
    assert noise_of_channels({"l": ChannelConfig(noise=value)}, model).tolist() == [0.0, 0.0, 0.0]
    with pytest.raises(InputError, match=r"sensors\.l:"):
        noise_of_channels({"l": ChannelConfig(noise=1.0)}, model)


def test_an_empty_list_of_factors_asks_for_nothing():
    assert SensitivityConfig(prior_width_factors=[], random_scale_grid_um=[]).prior_width_factors == []
