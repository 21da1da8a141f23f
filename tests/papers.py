"""Modules of the papers' experiments: once a config's class is loaded, `from yu2023...` and the like import them."""

from __future__ import annotations

import sys

import studies

from bayescal.config.registry import load_class

YU, RR, SIKA = (studies.EXPERIMENTS / name for name in ("yu2023", "rr8096", "sika2008"))

load_class("KINDS", "kind.py:HexapodCalibrations", YU)
load_class("KINDS", "self_calibrations.py:SelfCalibrations", SIKA)
claims = sys.modules[load_class("CLAIMS", "claims.py:Rr8096", studies.TELESCOPE).__module__]
pose_methods = sys.modules[load_class("KINDS", "pose_methods.py:PoseMethods", RR).__module__]
