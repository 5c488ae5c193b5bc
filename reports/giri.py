# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Giri, Rochdi, Chaoui: recursive identification with a hard input nonlinearity
#
# F. Giri, Y. Rochdi, F.-Z. Chaoui, *Recursive identification of systems with hard input nonlinearities of known
# structure*. The paper drives a Hammerstein system with impulses of four heights. At four heights any
# nonlinearity equals a polynomial, so the model becomes linear in products of parameters, which a gradient
# algorithm finds and a singular value decomposition takes apart.
#
# What we find: the idea works, and the estimates of the plant converge exactly when nothing disturbs it.
# But it is slow: 228 periods of the input to an error of one percent, where recursive least squares with the same
# regressors needs 15 samples; and the averaged information matrix promises a time half as long again.
# The example cannot show what its figure 3b shows: with both a dead zone and a preload that are not symmetric, only
# the slopes and offsets of the two segments can be identified. The parameter error is proportional to the
# disturbance, as claimed, with a factor that we compute. Eleven statements are printed wrongly, one of them the
# proposition on excitation, which lacks an assumption.

# %%
from replications.giri import report
from sysid.reporting import display

results = display.load()

# %% [markdown]
# ## The structure
#
# $$ y(t) = \frac{B(q^{-1})}{A(q^{-1})}\,u(t) + z(t), \qquad u(t) = F(v(t)), \tag{2.1} $$
#
# with two straight segments,
#
# $$ F(v) = \begin{cases} K_1 (v - D_1) + L_1 & v > D_1 \\ 0 & D_2 \le v \le D_1 \\
#    K_2 (v - D_2) + L_2 & v < D_2 \end{cases} \qquad D_2 \le 0 \le D_1 . $$

# %%
report.block_diagram()

# %%
report.segment_map()

# %% [markdown]
# ## From a nonlinear problem to a linear one
#
# Let $v(t)$ take only the values $0, V_1, \dots, V_4$, two of them beyond the dead zone on each side. With
# $d_j = F(V_j)/V_j$ the polynomial
#
# $$ P(v) = v \sum_{j=1}^4 d_j P_j(v), \qquad P_j(v) = \prod_{i \ne j} \frac{v - V_i}{V_j - V_i} \tag{3.3} $$
#
# equals $F$ there, without any approximation, and
#
# $$ A(q^{-1})\,y(t) = \sum_{i=1}^n \sum_{j=1}^4 \mu_{ij}\, v(t-i)\, P_j(v(t-i)) + \eta(t), \qquad
#    \mu_{ij} = b_i d_j, \quad \eta = A(q^{-1}) z \tag{3.7} $$
#
# is linear in $\theta^* = (a_i, \mu_{ij})$. Since $v P_j(v)$ is $V_j$ at the level $V_j$ and zero at the others, the
# polynomial never needs to be evaluated: a regressor holds the lagged impulses, sorted by height.

# %%
report.theta_star(results)

# %% [markdown]
# ## The algorithm, and how fast it is
#
# $$ \theta'(t) = \hat\theta(t-1) + \frac{\Phi(t)\, e(t)}{1 + \Phi(t)^T\Phi(t)}, \qquad
#    e(t) = y(t) - \Phi(t)^T \hat\theta(t-1), \tag{4.1} $$
#
# followed by projection on the ball of radius $\rho^*$. The input is periodic with $T = 7n$ samples, so without noise
# the parameter error obeys a linear recursion with periodic coefficients, and its rate is the spectral radius of
#
# $$ \prod_{t=1}^{T} \left( I - \frac{\Phi(t)\Phi(t)^T}{1 + \Phi(t)^T\Phi(t)} \right) . $$

# %%
report.figure_3a(results)

# %%
report.figure_3b(results)

# %%
report.convergence(results)

# %%
report.settings(results)

# %% [markdown]
# ### Proposition 4.1
#
# The parameter error is bounded; the increments and posterior errors are square summable without noise, and small in
# the mean with it. None of this needs excitation, and none of it says that the parameters are right.

# %%
report.proposition_4_1(results)

# %% [markdown]
# ## Back to the plant
#
# $M = (\mu_{ij}) = b\,d^T$ is of rank one, so its singular value decomposition gives $b$ and $d$ up to one factor, which a
# normalisation fixes. Two points a side then give slope and offset of each segment, $F(v) = K_i v + H_i$ with
# $H_i = L_i - K_iD_i$: one equation for two unknowns.

# %%
report.identifiability(results)

# %% [markdown]
# ## Why the impulses are unevenly spaced
#
# The input (5.1) puts its impulses at $2n, 4n, 5n, 6n$ of a period of $7n$ samples. Each impulse is followed by the $n$
# samples in which it stands in the regressor; outside these the plant runs free, and only there $a$ is
# seen alone. With even spacing ($2n, 3n, 4n, 5n$) there is one free stretch, and its initial state holds the pole $p$
# with the weight $\sum_j F(V_j)\,p^{-n(j-1)}$. A plant whose pole is a root of that is not identified, and the paper's own
# nonlinearity has such a root. The gap after $V_1$ opens a second free stretch, which differs from the first by the
# response to $V_1$ alone. Both miss a pole only if $F(V_1) = 0$: this is the assumption that Proposition 5.1 lacks.

# %%
report.excitation(results)

# %%
report.excitation_table(results)

# %% [markdown]
# ## Disturbances
#
# Proposition 5.2 bounds the mean parameter error by a multiple of the mean of $|\eta|$ and does not tell the multiple.
# While $z$ is small, the parameter error is a linear function of $\eta$ with periodic coefficients: for independent
# draws its covariance follows from a periodic Lyapunov equation, for a periodic disturbance the error itself
# is found by one linear system. Simulation agrees.

# %%
report.disturbance(results)

# %%
report.disturbance_table(results)

# %% [markdown]
# ## What is better
#
# The regression is that of least squares, so recursive least squares in square-root form takes the place of (4.1) at
# once, at one period of the input in place of hundreds. The printed recovery takes the rank-one matrix nearest to
# $\hat M$ with all its elements weighted alike. *Structured* least squares minimises the same sum of squares under
# $\mu_{ij} = b_id_j$, from the triangle that the recursion keeps; no data are needed again.

# %%
report.speed(results)

# %%
report.precision(results)

# %%
report.precision_tables(results)

# %% [markdown]
# A white disturbance $z$ of the output is not white in (3.7): $\eta = Az$ is correlated with the lagged outputs,
# and least squares, recursive or not, is biased by a term of order $\sigma^2$. It is small here. The printed algorithm has
# the same bias, hidden under its larger scatter. Who needs the last digit fits the output error instead.
#
# ## Printing errors
#
# Each printed form is held against an independent evaluation.

# %%
report.errata(results)

# %% [markdown]
# ### What is right

# %%
report.confirmed(results)

# %% [markdown]
# ## Claims

# %%
display.claims(results, "giri")

# %% [markdown]
# ## Gates

# %%
display.gates(results, "giri")

# %% [markdown]
# ## Monte-Carlo studies in full

# %%
report.studies(results)
