"""The law or the course of each effect of a model, from the signals that run between them."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from sysid.diagnosis.effect_views.probing import is_instantaneous, is_static
from sysid.diagnosis.effect_views.view import PER_SAMPLE, EffectView
from sysid.diagnosis.effects.base import Floats, Map
from sysid.diagnosis.export.saved import Saved, saved_model
from sysid.diagnosis.export.saved_effects import SavedEffect
from sysid.diagnosis.export.saved_linear import SavedModel
from sysid.diagnosis.export.saved_physics import SavedPhysicalModel
from sysid.diagnosis.ladder import DiagnosedModel
from sysid.diagnosis.linear.parameters import units_of
from sysid.diagnosis.physics.structure import PhysicsStructure
from sysid.errors import SysidError
from sysid.physics.expressions import Expression, evaluate, symbols
from sysid.physics.grammar import parse
from sysid.physics.ports import Port

# Points of a law, rows of a course and of a loop.
POINTS, COURSE, LOOP = 401, 80, 450
# Below this share of its largest value a response has died away.
DIED_AWAY = 0.01


def effect_views(model: DiagnosedModel) -> tuple[EffectView, ...]:
    """Return a view of each effect of a model that has one.

    Delays and modes show in time, a force by what it depends on; what is a number alone, and what bounds
    or drains a tank, has no view.

    Parameters
    ----------
    model : DiagnosedModel
    """
    try:
        return _Signals(model).views()
    except SysidError:  # a model or an effect of the user's own class, a run that diverges from rest
        return ()


class _Signals:
    """The signals between the effects of a model, in one sequence for each experiment."""

    def __init__(self, model: DiagnosedModel) -> None:
        self.saved: Saved = saved_model(model)
        self.record = model.structure.record
        self.rows = max(part.stop - part.start for part in self.record.slices)
        self.units, self.port = units_of(self.record), Port()
        if isinstance(model.structure, PhysicsStructure):
            self.units, self.port = model.structure.setting.units, model.structure.plant.port
        before_sensor = self._at("input", "force", "gain", "flow", "parallel")
        self.inner: Saved = replace(self.saved, effects=before_sensor)

    def _at(self, *ports: str) -> tuple[SavedEffect, ...]:
        return tuple(effect for effect in self.saved.effects if effect.effect.port in ports)

    def views(self) -> tuple[EffectView, ...]:
        inputs = [np.ascontiguousarray(self.record.u[part, 0]) for part in self.record.slices]
        found = self._maps("input", inputs)
        single = {"force": self._force, "gain": self._gain, "parallel": self._response}
        for effect in self._at(*single):
            view = single[effect.effect.port](effect)
            found += [] if view is None else [view]
        if self._at("output"):
            found += self._maps("output", self._outputs())
        order = [effect.name for effect in self.saved.effects]
        return tuple(sorted(found, key=lambda view: order.index(view.effect)))

    def _driven(self) -> list[Floats]:
        u = self.record.u if self.record.u.shape[1] > 1 else self.record.u[:, 0]
        return [u[part] for part in self.record.slices]

    def _outputs(self) -> list[Floats]:
        """Return what the sensor sees, from rest."""
        return [self.inner.simulate(u) for u in self._driven()]

    def _maps(self, port: str, signals: list[Floats]) -> list[EffectView]:
        """Return views of the maps at the input or at the output, each fed by the one before."""
        found = []
        for effect in self._at(port):
            apply, p = effect.choice.form.apply, np.array(effect.values)
            assert apply is not None
            passed = partial(_passed, apply, p, self.saved.period)
            after = [passed(s) for s in signals]
            found.append(self._map(effect.name, port, passed, signals, after))
            signals = after
        return found

    def _map(
        self,
        effect: str,
        port: str,
        passed: Callable[[Floats], Floats],
        before: Sequence[Floats],
        after: Sequence[Floats],
    ) -> EffectView:
        at_input = port == "input"
        name = (self.record.inputs if at_input else self.record.outputs)[0]
        unit, seen = self.units["u" if at_input else "y"], np.concatenate(before)
        if not is_instantaneous(passed, seen):
            t, s, x = self._course(before, after)
            return EffectView(effect, "course", "time", "s", name, unit, t, x, s, np.zeros(0))
        if is_static(passed, seen):
            value = np.linspace(seen.min(), seen.max(), POINTS)
            enters, leaves = name, f"{name} that acts"
            if not at_input:
                enters, leaves = f"{name} before the sensor", f"{name} read"
            at = port if at_input else ""
            return EffectView(
                effect, "law", enters, unit, leaves, unit, value, passed(value), value, seen, at
            )
        added = passed(np.zeros(self.rows))
        if np.ptp(added) > 0.0:
            return self._over_time(effect, f"added to {name}", unit, added, 0.0)
        return self._over_time(effect, f"factor of {name}", "", passed(np.ones(self.rows)) - added, 1.0)

    def _over_time(self, effect: str, result: str, unit: str, law: Floats, without: float) -> EffectView:
        t, nothing = self._times(law.size), np.full(law.size, without)
        return EffectView(effect, "time", "time", "s", result, unit, t, law, nothing, np.zeros(0))

    def _times(self, size: int) -> Floats:
        return np.asarray(self.saved.period * np.arange(size))

    def _response(self, effect: SavedEffect) -> EffectView | None:
        """Return what a path beside the model adds after a pulse of one sample, until it has died away."""
        form, pulse = effect.choice.form, np.zeros(self.rows)
        assert form.apply is not None
        pulse[0] = 1.0
        response = np.asarray(form.apply(pulse, np.array(effect.values), self.saved.period))
        last = int(np.flatnonzero(np.abs(response) >= DIED_AWAY * np.abs(response).max())[-1]) + 2
        if last <= 2:
            return None
        result = f"added to {self.record.outputs[0]} after a unit pulse"
        return self._over_time(effect.name, result, self.units["y"], response[:last], 0.0)

    def _course(self, before: Sequence[Floats], after: Sequence[Floats]) -> tuple[Floats, Floats, Floats]:
        """Return the stretch in which a map changes most: time, what enters, what leaves."""
        best, chosen = -1.0, (0, slice(0))
        for number, (s, x) in enumerate(zip(before, after, strict=True)):
            alike = float(s @ x) / (float(s @ s) or 1.0)
            change = np.concatenate([[0.0], np.cumsum((x - alike * s) ** 2)])
            length = min(COURSE, s.size)
            moved = change[length:] - change[:-length]
            if moved.max() > best:
                first = int(np.argmax(moved))
                best, chosen = float(moved.max()), (number, slice(first, first + length))
        number, rows = chosen
        return self._times(len(before[number]))[rows], before[number][rows], after[number][rows]

    def _motion(self) -> list[tuple[Floats, Floats]] | None:
        """Return position and speed in each experiment, from rest, in the model's own units."""
        inner = self.inner
        if isinstance(inner, SavedModel):
            outputs = [inner.simulate(u) for u in self._driven()]
            return [(z, np.diff(z, prepend=z[:1])) for z in outputs]
        assert isinstance(inner, SavedPhysicalModel)
        if self.port.velocity is None or self.port.position is None:
            return None
        states = [inner.visited(u) for u in self._driven()]
        return [(s[:, self.port.position], s[:, self.port.velocity]) for s in states]

    def _force(self, effect: SavedEffect) -> EffectView | None:
        form = effect.choice.form
        names = [p.name for p in form.parameters]
        law = parse(form.expression, {"x", "v", "z", *names})
        values = effect.parameters
        motion = self._motion()
        if motion is None:
            return None
        if form.state:
            # The first rows of the stretch are left out: they begin without a past.
            position, speed = (signal[-LOOP:] for signal in max(motion, key=lambda run: len(run[0])))
            rate = parse(form.state, {"x", "v", "z", *names})
            z = _driven_state(rate, values, position, speed, self.saved.period)
            rows = zip(position.tolist(), speed.tolist(), z.tolist(), strict=True)
            force = np.array([evaluate(law, values | {"x": a, "v": b, "z": c}) for a, b, c in rows])
            shown = slice(len(z) // 3, None)
            return self._force_view(effect.name, "loop", "x", position[shown], force[shown], position)
        depends = sorted(symbols(law) & {"x", "v"})
        if len(depends) != 1:
            return None
        (on,) = depends
        seen = np.concatenate([run[on == "v"] for run in motion])
        seen = seen[np.isfinite(seen)]
        value = np.union1d(np.linspace(seen.min(), seen.max(), POINTS), [0.0])
        force = np.array([evaluate(law, values | {on: float(a)}) for a in value])
        view = self._force_view(effect.name, "law", on, value, force, seen)
        return replace(view, port="") if effect.effect.dry else view

    def _force_view(
        self, effect: str, kind: str, on: str, value: Floats, force: Floats, seen: Floats
    ) -> EffectView:
        quantity = port = {"x": "position", "v": "velocity"}[on]
        if on == "v" and isinstance(self.saved, SavedModel):
            quantity = PER_SAMPLE
        names = quantity, self.units[on], "force against it", self.units["F"]
        return EffectView(effect, kind, *names, value, force, np.zeros(value.size), seen, port)

    def _gain(self, effect: SavedEffect) -> EffectView | None:
        form = effect.choice.form
        law = parse(form.expression, {"y", *(p.name for p in form.parameters)})
        seen = np.concatenate(self._outputs())
        value = np.linspace(seen.min(), seen.max(), POINTS)
        factor = np.array([evaluate(law, effect.parameters | {"y": float(a)}) for a in value])
        name = self.record.outputs[0]
        result = f"factor of {self.record.inputs[0]}"
        return EffectView(
            effect.name, "law", name, self.units["y"], result, "", value, factor, np.ones(value.size), seen
        )


def _passed(apply: Map, p: Floats, period: float, s: Floats) -> Floats:
    return np.asarray(apply(s, p, period))


def _driven_state(
    rate: Expression, values: dict[str, float], position: Floats, speed: Floats, period: float
) -> Floats:
    """Integrate the internal state of a force along a motion that is straight between rows; from zero."""
    from scipy.integrate import solve_ivp

    t = period * np.arange(len(speed))

    def slope(at: float, z: Floats) -> list[float]:
        here = {"x": float(np.interp(at, t, position)), "v": float(np.interp(at, t, speed))}
        return [evaluate(rate, values | here | {"z": float(z[0])})]

    # A stiff contact follows the motion at once.
    found = solve_ivp(slope, (0.0, t[-1]), [0.0], "LSODA", t, rtol=1e-4, max_step=period)
    return np.asarray(found.y[0])
