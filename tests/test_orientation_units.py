"""The noise of a rotation in arcseconds or in microradians, never in both."""

from __future__ import annotations

import pytest

from bayescal.experiments.shared.readings.data_schema import PoseDataConfig
from bayescal.experiments.shared.schema import PoseSensorConfig
from bayescal.experiments.simulation.schema import PoseInstrumentConfig

SECTIONS = {
    PoseSensorConfig: {"kind": "pose"},
    PoseInstrumentConfig: {"kind": "poses", "position_um": 1.0},
    PoseDataConfig: {"kind": "poses", "file": "p.csv"},
}


@pytest.mark.parametrize("section", SECTIONS)
def test_microradians_are_arcseconds_of_another_size(section):
    one = section.model_validate({**SECTIONS[section], "orientation_urad": 4.84813681109536})
    assert one.arcseconds == pytest.approx(1.0, rel=1e-14)
    other = section.model_validate({**SECTIONS[section], "orientation_arcsec": 2.0})
    assert other.arcseconds == 2.0
    assert "orientation_urad" not in other.model_dump()


@pytest.mark.parametrize("section", SECTIONS)
def test_both_at_once_are_refused(section):
    with pytest.raises(ValueError, match="orientation_arcsec 2 and orientation_urad 3"):
        section.model_validate({**SECTIONS[section], "orientation_arcsec": 2.0, "orientation_urad": 3.0})
