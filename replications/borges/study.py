"""The Monte-Carlo experiment of Section 4, with the comparisons that the paper leaves out."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from replications.borges import setting
from sysid.local_linear import LocalLinearModel, Problem, Sizes, identity_descent
from sysid.local_linear.problem import JACOBIANS, At
from sysid.local_linear.search import linear_starts
from sysid.separable import descend
from sysid.separable.factor import fold

Floats = NDArray[np.float64]

EVALUATIONS = 60
NEAR = 1.5
"""A run has arrived when its cost is below this multiple of the best cost of all methods."""


@dataclass(frozen=True)
class Joint:
    """The same problem with nothing eliminated: parameters (eta, theta)."""

    problem: Problem
    values: Floats

    @property
    def cost(self) -> float:
        """Sum of squared residuals."""
        if not np.isfinite(self.values).all():
            return np.inf
        with np.errstate(all="ignore"):
            residual = self.residual()
            return float(residual @ residual) if np.isfinite(residual).all() else np.inf

    def residual(self) -> Floats:
        """Return data less simulation, output by output."""
        return self.problem.y[0].ravel() - self._model().simulate(*self._signals()).ravel()

    def _model(self) -> LocalLinearModel:
        return model_of(self.problem.sizes, self.values)

    def _signals(self) -> tuple[Floats, Floats]:
        experiment = self.problem.experiments[0]
        return experiment.inputs[:, :-1], experiment.scheduling

    def linearise(self) -> tuple[Floats, Floats]:
        """Return the Jacobian [D Phi] and the residual, in coordinates in which both are triangular."""
        from sysid.local_linear.gradients import approach_2b
        from sysid.local_linear.passes import regressors
        from sysid.local_linear.structure import course

        sizes = self.problem.sizes
        one = course(sizes, self.values[: sizes.n_eta], self.problem.experiments[0])
        G = self.values[sizes.n_eta :].reshape(sizes.n_states, -1)
        phi = regressors(one).reshape(-1, sizes.n_linear)
        rows = np.hstack([approach_2b(one, G), -phi, self.residual()[:, np.newaxis]])
        factor = fold(None, np.ascontiguousarray(rows.T))
        return factor[:, :-1], factor[:, -1]


def model_of(sizes: Sizes, values: Floats) -> LocalLinearModel:
    """Return the model of parameters (eta, theta)."""
    return LocalLinearModel.of(
        sizes, values[: sizes.n_eta], values[sizes.n_eta :].reshape(sizes.n_states, -1)
    )


@dataclass(frozen=True)
class Run:
    """One experiment of Section 4: all methods from one start, scored on fresh noise-free data.

    Attributes
    ----------
    q : int
        Scheduling signals: 1, the first input, or 2.
    noise : str
        A key of `setting.NOISE`.
    evaluations : int
        Evaluations of the cost of each method.
    methods : {"sls", "searches", "all"}
        Separable least squares alone; with all its derivatives and joint optimisation; and with (15) too.
    """

    q: int
    noise: str
    evaluations: int = EVALUATIONS
    methods: str = "all"

    def __call__(self, rng: np.random.Generator) -> Mapping[str, float]:
        """Return VAF, RMSE, costs and iterations."""
        u, y, _ = setting.experiment(rng, self.noise)
        fresh_u, _, fresh_y = setting.experiment(rng, "noise-free")
        problem = setting.problem_of(u, y, self.q)
        eta = setting.start(problem, rng)
        traces: dict[str, list[float]] = {}
        models = {"linear": self._linear(u, y), "start": _full(problem, eta)}
        for jacobian in JACOBIANS if self.methods != "sls" else JACOBIANS[:1]:
            traces[jacobian] = []
            chosen = setting.problem_of(u, y, self.q, jacobian)
            found = descend(_traced(chosen, traces[jacobian]), eta, max_evaluations=self.evaluations)
            models[jacobian] = _full(problem, found.x)
        if self.methods != "sls":
            models["joint"] = self._joint(problem, eta, traces)
        if self.methods == "all":
            self._projected(u, y, eta, traces)
        return self._scores(models, fresh_u, fresh_y) | _arrivals(traces, self.evaluations)

    def _linear(self, u: Floats, y: Floats) -> LocalLinearModel:
        alone = setting.problem_of(u, y, 1)
        sizes = Sizes(setting.N_STATES, 1, setting.N_INPUTS, setting.N_OUTPUTS, 1)
        A, C = linear_starts(alone)[1]
        eta = sizes.pack(A[np.newaxis], C, np.ones((1, 1)), np.zeros((1, 1)))
        return _full(Problem(sizes, alone.experiments, alone.y, alone.used), eta)

    def _joint(self, problem: Problem, eta: Floats, traces: dict[str, list[float]]) -> LocalLinearModel:
        begin = np.concatenate([eta, problem(eta).solution.theta])
        traces["joint"] = []

        def evaluate(values: Floats) -> Joint:
            point = Joint(problem, values)
            traces["joint"].append(point.cost)
            return point

        found = descend(evaluate, begin, max_evaluations=self.evaluations)
        return model_of(problem.sizes, found.x)

    def _projected(self, u: Floats, y: Floats, eta: Floats, traces: dict[str, list[float]]) -> None:
        """Descend by (15) with and without projection; the printed derivative and Kaufman's."""
        for jacobian in (JACOBIANS[0], JACOBIANS[2]):
            for projected in (False, True):
                name = f"identity/{jacobian}/{'projected' if projected else 'free'}"
                chosen = setting.problem_of(u, y, self.q, jacobian)
                traces[name] = []
                steps = self.evaluations // 3
                identity_descent(_traced(chosen, traces[name]), eta, steps, projected=projected)

    def _scores(self, models: Mapping[str, LocalLinearModel], u: Floats, y: Floats) -> dict[str, float]:
        scores = {}
        for name, model in models.items():
            off = y - model.simulate(u, u[:, : model.sizes.n_scheduling])
            for o in range(setting.N_OUTPUTS):
                with np.errstate(all="ignore"):
                    variance = np.var(off[:, o]) / np.var(y[:, o])
                    rmse = np.sqrt(np.mean(off[:, o] ** 2))
                # A model that diverges on fresh data explains nothing of them.
                sane = bool(np.isfinite(variance) and variance < 1.0)
                scores[f"{name}/vaf/output-{o + 1}"] = 100.0 * (1.0 - float(variance)) if sane else 0.0
                scores[f"{name}/rmse/output-{o + 1}"] = float(rmse) if sane else float(np.std(y[:, o]))
        return scores


def _full(problem: Problem, eta: Floats) -> LocalLinearModel:
    return LocalLinearModel.of(problem.sizes, eta, problem(eta).gains())


def _traced(problem: Problem, trace: list[float]) -> Callable[[Floats], At]:
    def evaluate(eta: Floats) -> At:
        point = problem(eta)
        trace.append(point.cost)
        return point

    return evaluate


def _arrivals(traces: Mapping[str, list[float]], limit: int) -> dict[str, float]:
    """Return evaluations to 1.5 times the best cost (one more than the limit if never), and final costs."""
    best = min(min(trace) for trace in traces.values())
    found = {}
    for name, trace in traces.items():
        near = np.flatnonzero(np.array(trace) <= NEAR * best)
        found[f"{name}/iterations"] = float(near[0]) if near.size else float(limit + 1)
        found[f"{name}/cost_over_best"] = min(trace) / best
    return found
