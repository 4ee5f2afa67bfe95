"""Trackers that are programs of their own, in any language: a line of JSON in, a line out.

docs/guide/external_trackers.md specifies the lines.
"""

from pmbm.external.program import EXEC, Program, program_named

__all__ = ["EXEC", "Program", "program_named"]
