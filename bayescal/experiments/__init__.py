"""Kinds of experiment on one frame; a new one is a folder and a line."""

KINDS = {
    "audit": "bayescal.experiments.audit.kind:Audit",
    "selection": "bayescal.experiments.selection.kind:Selection",
    "selftest": "bayescal.experiments.selftest.kind:Selftest",
    "sessions": "bayescal.experiments.sessions.kind:Sessions",
    "simulation": "bayescal.experiments.simulation.kind:Simulation",
    "study": "bayescal.experiments.study.kind:Study",
    "sweep": "bayescal.experiments.sweep.kind:Sweep",
    "table": "bayescal.experiments.table.kind:LookUpTable",
}

USES = {"next_pose": "bayescal.experiments.next_pose.kind:NextPose"}
"""What is asked of a study: it has results of its own, but no kind in its file, which names the study."""
