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

SCHEMAS = {
    "audit": "bayescal.experiments.audit.schema:AuditConfig",
    "next_pose": "bayescal.experiments.next_pose.schema:NextPoseConfig",
    "selection": "bayescal.experiments.selection.schema:SelectionConfig",
    "selftest": "bayescal.experiments.selftest.schema:SelftestConfig",
    "sessions": "bayescal.experiments.sessions.schema:SessionsConfig",
    "simulation": "bayescal.experiments.simulation.schema:SimulationConfig",
    "study": "bayescal.experiments.shared.study_schema:StudyConfig",
    "sweep": "bayescal.experiments.sweep.schema:SweepConfig",
    "table": "bayescal.experiments.table.schema:TableConfig",
}
"""The `schema` of each kind, which editors ask for without what the kind computes with."""
