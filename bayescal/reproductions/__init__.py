"""Reproductions of papers: kinds of experiment and claims of one paper each."""

KINDS = {
    "hexapod_calibrations": "bayescal.reproductions.yu2023.kind:HexapodCalibrations",
    "pose_methods": "bayescal.reproductions.rr8096.pose_methods.kind:PoseMethods",
    "self_calibrations": "bayescal.reproductions.sika2008.kind:SelfCalibrations",
}

CLAIMS = {"rr8096": "bayescal.reproductions.rr8096.claims:Rr8096"}
