"""Exceptions of the library; each message says what, where, the value and the remedy."""


class SysidError(Exception):
    """Base of all errors the library raises on purpose; the command line exits with 2."""


class UsageError(SysidError, ValueError):
    """An option or argument is wrong."""


class DataError(SysidError, ValueError):
    """A measurement file or record cannot be used as it is."""


class ModelError(SysidError, ValueError):
    """A model structure, parameter name or parameter value is wrong."""


class IdentifiabilityError(SysidError, ValueError):
    """The data cannot determine the parameters that were asked for."""


class ReportError(SysidError, RuntimeError):
    """A report cannot be built from its notebook and results."""
