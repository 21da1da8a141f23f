"""Modules of the papers' experiments: once a config's class is loaded, `from yu2023...` and `rr8096...` import them."""

from __future__ import annotations

import sys

import studies

from bayescal.config.registry import load_class

YU, RR = studies.EXPERIMENTS / "yu2023", studies.EXPERIMENTS / "rr8096"

load_class("KINDS", "kind.py:HexapodCalibrations", YU)
claims = sys.modules[load_class("CLAIMS", "claims.py:Rr8096", RR).__module__]
pose_methods = sys.modules[load_class("KINDS", "pose_methods.py:PoseMethods", RR).__module__]
