"""Reproductions of papers: kinds of experiment of one paper each."""

KINDS = {"self_calibrations": "bayescal.reproductions.sika2008.kind:SelfCalibrations"}
