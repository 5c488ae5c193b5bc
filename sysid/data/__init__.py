"""Measurements: records, how they are read, and what is checked before they are used."""

from sysid.data.reading import read_record
from sysid.data.record import Record, make_record
from sysid.data.resampling import resample

__all__ = ["Record", "make_record", "read_record", "resample"]
