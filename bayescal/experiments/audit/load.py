"""Reading an audit's design."""

from __future__ import annotations

from pathlib import Path

from bayescal.experiments.audit.schema import AuditConfig
from bayescal.experiments.frame.load import load_kind


def load_audit(path: Path) -> AuditConfig:
    """Return the checked design of an audit; InputError for anything at fault, with file, line, found and expected."""
    config: AuditConfig = load_kind(path, "audit")
    return config
