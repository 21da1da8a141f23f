"""Errors of calibrated machines, by hand."""

from __future__ import annotations

import numpy as np
from hexapod_settings import load_setting

from yu2023.least_squares import PoseErrors, evaluate

SETTING = load_setting()
MACHINE = SETTING.machine


def test_integrated_error_by_hand():
    errors = PoseErrors(np.array([[3.0, 4.0]]), np.array([[0.1, 0.2]]))
    np.testing.assert_allclose(errors.integrated("rad"), np.sqrt((3.1**2 + 4.2**2) / 2))
    degrees = np.degrees([0.1, 0.2])
    np.testing.assert_allclose(errors.integrated("deg"), np.sqrt(((3 + degrees[0]) ** 2 + (4 + degrees[1]) ** 2) / 2))
    figures = errors.figures
    assert figures["position_max_mm"] == 4.0
    assert figures["position_mean_mm"] == 3.5
    np.testing.assert_allclose(figures["attitude_mean_deg"], np.degrees(0.15))
    np.testing.assert_allclose(figures["attitude_max_deg"], np.degrees(0.2))


def test_perfect_calibration_has_no_error():
    truth = SETTING.draw_machines(3, np.random.default_rng(0))
    errors = evaluate(MACHINE, truth, truth, SETTING.targets)
    assert errors.position.shape == (3, 150)
    assert errors.position.max() < 1e-9
    assert errors.attitude.max() < 1e-12


def test_shifted_base_moves_the_platform_by_as_much():
    nominal = MACHINE.layout.nominal
    truth = nominal.copy()
    for symbol, shift in (("a_x", 0.3), ("a_y", -0.4)):
        truth[MACHINE.layout.index[symbol]] += shift
    errors = evaluate(MACHINE, truth[None], nominal[None], SETTING.targets)
    np.testing.assert_allclose(errors.position, 0.5, atol=1e-9)
    assert errors.attitude.max() < 1e-10


def test_failed_calibrations_have_no_errors():
    nominal = MACHINE.layout.nominal
    found = np.stack([nominal, np.full_like(nominal, np.nan)])
    errors = evaluate(MACHINE, np.tile(nominal, (2, 1)), found, SETTING.targets)
    assert np.isnan(errors.position[1]).all()
    assert errors.position[0].max() < 1e-9
