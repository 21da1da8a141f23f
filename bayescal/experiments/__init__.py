"""Kinds of experiment on one frame; a new one is a folder and a line."""

KINDS = {
    "audit": "bayescal.experiments.audit.kind:Audit",
    "check": "bayescal.experiments.check.kind:Check",
    "selection": "bayescal.experiments.selection.kind:Selection",
    "sessions": "bayescal.experiments.sessions.kind:Sessions",
    "simulation": "bayescal.experiments.simulation.kind:Simulation",
    "study": "bayescal.experiments.study.kind:Study",
    "sweep": "bayescal.experiments.sweep.kind:Sweep",
    "table": "bayescal.experiments.table.kind:LookUpTable",
}

USES = {"next": "bayescal.experiments.next.kind:NextPose"}
"""What is asked of a study: it has results of its own, but no kind in its file, which names the study."""

GONE = {
    "calibration": "study",
    "calibration_audit": "audit",
    "next_pose": "no kind in a file that names a study, which `bayescal next` takes",
    "calibration_simulation": "simulation",
    "lookup_table": "table",
    "pose_selection": "selection",
    "reading_simulation": "simulation",
    "self_calibration": "study",
    "sensor_placement": "audit",
}
"""Kinds that are no more, and what does the same: another kind, or what to write."""
