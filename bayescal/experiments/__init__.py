"""Kinds of experiment on one frame; a new one is a folder and a line."""

KINDS = {
    "audit": "bayescal.experiments.audit.kind:Audit",
    "calibration_audit": "bayescal.experiments.calibration.audit.kind:CalibrationAudit",
    "check": "bayescal.experiments.check.kind:Check",
    "next_pose": "bayescal.experiments.next_pose.kind:NextPose",
    "selection": "bayescal.experiments.selection.kind:Selection",
    "sessions": "bayescal.experiments.sessions.kind:Sessions",
    "simulation": "bayescal.experiments.simulation.kind:Simulation",
    "study": "bayescal.experiments.study.kind:Study",
    "sweep": "bayescal.experiments.sweep.kind:Sweep",
    "table": "bayescal.experiments.table.kind:LookUpTable",
}

GONE = {
    "calibration": "study",
    "calibration_simulation": "simulation",
    "lookup_table": "table",
    "pose_selection": "selection",
    "reading_simulation": "simulation",
    "self_calibration": "study",
    "sensor_placement": "calibration_audit",
}
"""Kinds that are no more, and what does the same."""
