"""Reports: a run's results and the papers' notebooks become one HTML page and one PDF."""

from sysid.reporting.builder import FORMATS, build

__all__ = ["FORMATS", "build"]
