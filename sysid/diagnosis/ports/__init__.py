"""Free-form curves at the ports of a fitted model: the picture of the missing map."""

from sysid.diagnosis.ports.curves import PortCurve, explore_ports

__all__ = ["PortCurve", "explore_ports"]
