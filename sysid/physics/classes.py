"""A model as a small Python class, whose equations are read off by calling it once with symbols."""

import importlib
import importlib.util
import math
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, TypeGuard

from sysid.errors import ModelError
from sysid.physics.expressions import ONE, Expression, Symbol
from sysid.physics.model import Equation, Model, Output, Parameter, Term, Variable
from sysid.physics.names import checked_name
from sysid.physics.symbolic import Symbolic, expression_of

_PYTHON_NAME = re.compile(r"[A-Za-z_][\w.]*")


class PhysicsModel:
    """Base of models that are written as Python classes.

    `rates` and `measured` are called once, with symbols for states, inputs and parameters: what they
    compute is kept as equations, differentiated, and compiled like that of a TOML file.  So they may
    hold any arithmetic, the functions of NumPy that the grammar has (``abs``, ``sign``, ``sqrt``, ``exp``,
    ``log``, ``sin``, ``cos``, ``tanh``, ``minimum``, ``maximum``, ``where``), loops and helpers; a choice
    that depends on a state is written with ``numpy.where``, not with ``if``.

    Attributes
    ----------
    name, title : str
        The class's name and first line of documentation by default.
    states, inputs, outputs : mapping of str to str
        Names with units.
    parameters : sequence of Parameter
    rest : mapping of str to float
        Value of a state at rest, where that is not zero.

    Examples
    --------
    >>> import numpy as np
    >>> class Pendulum(PhysicsModel):
    ...     "Pendulum driven by a torque"
    ...     states = {"angle": "rad", "speed": "rad/s"}
    ...     inputs = {"torque": "N m"}
    ...     outputs = {"y": "rad"}
    ...     parameters = (Parameter("J", "kg m^2", 0.1, 0.0), Parameter("mgl", "N m", 1.0, 0.0))
    ...     def rates(self, x, u, p):
    ...         return x.speed, (u.torque - p.mgl * np.sin(x.angle)) / p.J
    ...     def measured(self, x, u, p):
    ...         return x.angle
    >>> print(Pendulum.model())
    angle' = speed
    speed' = (torque - mgl*sin(angle))/J
    y = angle
    """

    name: ClassVar[str] = ""
    title: ClassVar[str] = ""
    states: ClassVar[Mapping[str, str]] = {}
    inputs: ClassVar[Mapping[str, str]] = {}
    outputs: ClassVar[Mapping[str, str]] = {}
    parameters: ClassVar[Sequence[Parameter]] = ()
    rest: ClassVar[Mapping[str, float]] = {}

    def rates(self, x: Any, u: Any, p: Any) -> Any:
        """Return the derivative of each state [unit/s], in the order of the states.

        Parameters
        ----------
        x, u, p : tuple with names
            States, inputs and parameters, as ``x.speed``, ``u[0]`` or unpacked.
        """
        raise ModelError(f"model class {type(self).__name__} has no method rates(self, x, u, p): write one")

    def measured(self, x: Any, u: Any, p: Any) -> Any:
        """Return each output; by default the states of the same names, or the first one."""
        names = list(self.outputs)
        return [getattr(x, name) for name in names] if set(names) <= set(self.states) else x[0]

    @classmethod
    def model(cls) -> Model:
        """Return the model that the class describes.

        Raises
        ------
        ModelError
            If a name, a parameter or an equation is wrong.
        """
        return _model(cls)


def is_model_class(thing: object) -> TypeGuard[type[PhysicsModel]]:
    """Return whether something is a class derived from `PhysicsModel`."""
    return isinstance(thing, type) and issubclass(thing, PhysicsModel)


def _model(cls: type[PhysicsModel]) -> Model:
    for kind, table in (("states", cls.states), ("inputs", cls.inputs), ("outputs", cls.outputs)):
        if not isinstance(table, Mapping) or not table:
            raise ModelError(f'{cls.__name__}.{kind} is {table!r}: give names with units, as {{"x": "m"}}')
        for name, unit in table.items():
            checked_name(str(name), f"{cls.__name__}.{kind}")
            if not isinstance(unit, str) or not unit.strip():
                raise ModelError(
                    f"{cls.__name__}.{kind}: {name!r} has the unit {unit!r}: give a text (1 if none)"
                )
    for parameter in cls.parameters:
        if not isinstance(parameter, Parameter):
            raise ModelError(
                f"{cls.__name__}.parameters holds {parameter!r}: give Parameter(name, unit, start)"
            )
        checked_name(parameter.name, f"{cls.__name__}.parameters")
        parameter.check()
    found = Model(
        name=cls.name or _kebab(cls.__name__),
        title=cls.title or ((cls.__doc__ or "").strip().splitlines() or [cls.__name__])[0],
        states=tuple(Variable(n, unit, rest=_rest(cls, n)) for n, unit in cls.states.items()),
        inputs=tuple(Variable(n, unit) for n, unit in cls.inputs.items()),
        outputs=tuple(Output(n, unit, ()) for n, unit in cls.outputs.items()),
        parameters=tuple(cls.parameters),
        equations=(),
        source=f"{cls.__module__}:{cls.__qualname__}",
    )
    found.check_names()
    rates = _traced(cls, "rates", found, list(cls.states))
    measured = _traced(cls, "measured", found, list(cls.outputs))
    finished = Model(
        name=found.name,
        title=found.title,
        states=found.states,
        inputs=found.inputs,
        outputs=tuple(
            Output(n, unit, (Term(n, e),)) for (n, unit), e in zip(cls.outputs.items(), measured, strict=True)
        ),
        parameters=found.parameters,
        equations=tuple(
            Equation(n, ONE, f"{unit}/s", (Term("rate", e),))
            for (n, unit), e in zip(cls.states.items(), rates, strict=True)
        ),
        source=found.source,
    )
    for name in finished.unused():
        raise ModelError(f"{cls.__name__}: parameter {name!r} occurs in no equation: use it or leave it out")
    return finished


def _rest(cls: type[PhysicsModel], state: str) -> float:
    value = cls.rest.get(state, 0.0)
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise ModelError(f"{cls.__name__}.rest: {state!r} is {value!r}: give a finite number")
    return float(value)


def _kebab(name: str) -> str:
    return re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", name).lower()


def _traced(cls: type[PhysicsModel], method: str, model: Model, names: list[str]) -> list[Expression]:
    """Call a method with symbols and return one expression for each name."""
    symbolic = [
        _symbols([state.name for state in model.states]),
        _symbols([variable.name for variable in model.inputs]),
        _symbols([parameter.name for parameter in model.parameters]),
    ]
    place = f"{cls.__name__}.{method}"
    try:
        result = getattr(cls(), method)(*symbolic)
    except ModelError:
        raise
    except Exception as problem:
        reason = " ".join(str(problem).split()) or type(problem).__name__
        raise ModelError(f"{place} fails ({type(problem).__name__}: {reason[:200]}): repair it") from None
    if isinstance(result, Mapping):
        missing = [name for name in names if name not in result]
        if missing or len(result) != len(names):
            raise ModelError(f"{place} gives {', '.join(map(str, result))}: give exactly {', '.join(names)}")
        result = [result[name] for name in names]
    elif isinstance(result, Symbolic | int | float):
        result = [result]
    try:
        parts = list(result)
    except TypeError:
        raise ModelError(
            f"{place} gives {result!r}: return one value for each of {', '.join(names)}"
        ) from None
    if len(parts) != len(names):
        raise ModelError(f"{place} gives {len(parts)} values: return one for each of {', '.join(names)}")
    found = []
    for name, part in zip(names, parts, strict=True):
        expression = expression_of(part)
        if expression is None:
            raise ModelError(
                f"{place} gives {part!r} for {name!r}: return numbers and expressions of x, u, p"
            )
        found.append(expression)
    return found


class Variables(tuple[Symbolic, ...]):
    """Symbols in order, each also an attribute of its name."""

    def __getattr__(self, name: str) -> Symbolic:
        for symbol in self:
            if symbol.expression == Symbol(name):
                return symbol
        raise AttributeError(f"there is no {name!r} among {', '.join(map(repr, self))}")


def _symbols(names: list[str]) -> Variables:
    return Variables(Symbolic.named(name) for name in names)


def load_class(address: str) -> Model:
    """Return the model of a class given as ``package.module:Class`` or ``file.py:Class``.

    The module is imported, so that its code runs: it is the user's own.

    Raises
    ------
    ModelError
        If it cannot be imported or holds no such class.
    """
    place, _, name = address.rpartition(":")
    module = _module(place, address)
    found = getattr(module, name, None)
    if isinstance(found, Model):
        return found
    if not is_model_class(found):
        known = [
            key for key, value in vars(module).items() if is_model_class(value) and value is not PhysicsModel
        ]
        listed = f": it has {', '.join(known)}" if known else " and no class derived from PhysicsModel"
        raise ModelError(f"{place} has no model class {name!r}{listed}")
    return found.model()


def _module(place: str, address: str) -> ModuleType:
    try:
        if place.endswith(".py"):
            return _from_file(Path(place))
        if not _PYTHON_NAME.fullmatch(place):
            raise ModelError(
                f"model {address!r}: {place!r} is no module: write package.module:Class or file.py:Class"
            )
        return importlib.import_module(place)
    except ModelError:
        raise
    except FileNotFoundError:
        raise ModelError(f"model {address!r}: there is no file {place}: check the path") from None
    except Exception as problem:
        reason = " ".join(str(problem).split()) or type(problem).__name__
        raise ModelError(
            f"model {address!r}: {place} cannot be imported ({type(problem).__name__}: {reason[:200]}): "
            "repair it, or run where it can be found"
        ) from None


def _from_file(path: Path) -> ModuleType:
    name = f"sysid_model_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None:
        raise FileNotFoundError(path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module
