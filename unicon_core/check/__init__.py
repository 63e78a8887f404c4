"""Preflight checks: every mismatch of workflow, policy, robot and platform found before it runs."""

from unicon_core.check.check import check_workflow, refuse_errors
from unicon_core.check.result import CheckResult, Finding, Section
from unicon_core.check.rules import CODES

__all__ = ["CODES", "CheckResult", "Finding", "Section", "check_workflow", "refuse_errors"]
