# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Bai: linear systems with hard input nonlinearities of known structure
#
# E.-W. Bai, *Identification of linear systems with hard input nonlinearities of known structure*, 15th IFAC World
# Congress, 2002. The paper identifies a linear system behind an input nonlinearity that is known up to one
# threshold $a$, by two methods: a search over $a$ alone, and correlation analysis with several input distributions.
#
# What we find: both methods work. The search method attains the least-squares bound from 100
# samples on, its table is plausible row by row and too good as a set, and the threshold of a relay converges like
# $1/N$, which the paper does not say. The correlation method is consistent, too, but with 2000 samples an input it
# is less precise than the search method with 100, and with independently drawn inputs its ratio of moments is too
# noisy at that length to be of use.
# Nine formulas are printed wrongly; each is proved wrong, and its correction right, by a number.

# %%
from replications.bai import report
from sysid.reporting import display

results = display.load()

# %% [markdown]
# ## The structure
#
# The system is
#
# $$ y(k) = \sum_{i=1}^{n} \alpha_i\, y(k-i) + \sum_{i=1}^{n} \beta_i\, x(k-i) + v(k), \tag{2.1} $$
#
# with $x(k) = \mathcal N(u(k), \dots, u(0), a)$. Note the sign of $\alpha$: with $A(q) = 1 + a_1q^{-1} + \dots$ it is
# minus the coefficient. The noise $v$ is an equation error.

# %%
report.block_diagram()

# %%
report.maps()

# %% [markdown]
# ## The search method
#
# For a given threshold the model is linear in $\theta = (\alpha, \beta)$, so $\theta$ is eliminated and the cost
# depends on $a$ alone:
#
# $$ J(a) = \frac{1}{N} \left\| \left(I - A(a)\left[A(a)^T A(a)\right]^{-1} A(a)^T\right) Y \right\|^2 . \tag{2.9} $$
#
# The paper minimises $J$ by looking at its plot. That is not needed: for every map of the paper the regressors
# are affine in $a$ between knots (the samples' $|u(k)|$, or for a hysteresis half the distance of two turning
# points). Inside such a cell the cost follows from one small Gram matrix, and passing a knot changes two rows of it.
# So all cells are examined in one pass whose time grows like $N$; the minimum is global by construction. For the
# relays $J$ is constant inside a cell, and the estimate is the midpoint of the best cell.

# %%
report.cost_curves(results)

# %%
report.minima(results)

# %% [markdown]
# ## Table 1
#
# Example 1: $n = 2$, true $a = 1$, $\theta = (-0.8333, -0.1667, 1, 1)$, noise uniform on $[-0.2, 0.2]$, input uniform
# on $[-4, 4]$, $N = 100$. The experiment starts at rest; the $N$ rows of (2.5) begin with the third sample, so that
# every regressor is measured.

# %%
report.table_1(results)

# %% [markdown]
# Is the printed table one draw of this protocol?

# %%
report.table_1_plausibility(results)

# %%
report.precision(results)

# %% [markdown]
# ## Consistency, shown
#
# The paper states strong consistency. Here it is, with its rate. A relay's output tells only between which two
# samples the threshold lies, and their distance falls like $1/N$: its estimate is superconsistent.

# %%
report.consistency(results)

# %%
report.slopes(results)

# %% [markdown]
# ## The correlation method
#
# With an i.i.d. input of zero mean and $q(f, a) = \mathrm E\,x(k)u(k)$ the correlations $w(i) = \mathrm E\,y(k)u(k-i)$
# satisfy
#
# $$ w(i) = \sum_{j=1}^{\min(i-1,\,n)} \alpha_j\, w(i-j) + q\beta_i \;\; (i \le n), \qquad
#    w(i) = \sum_{j=1}^{n} \alpha_j\, w(i-j) \;\; (i > n), \tag{3.3} $$
#
# which is solved for $\alpha$ and $q\beta$. Experiments with $l + 1$ input distributions give ratios
# $c_i = q(f_1, a)/q(f_{i+1}, a)$, and these the $l$ parameters of the map. For a saturation and uniform inputs on
# $[-b_1, b_1]$ and $[-b_2, b_2]$
#
# $$ a = \sqrt{\left| \frac{3 (c_1 b_2 - b_1)\, b_1 b_2}{c_1 b_1 - b_2} \right|} . \tag{3.14} $$
#
# Example 2 applies this with $N = 2000$, $b_1 = 2$, $b_2 = 3$ and noise on $[-0.1, 0.1]$, and prints
#
# $$ (\hat a, \hat\alpha_1, \hat\alpha_2, \hat\beta_1, \hat\beta_2) = (1.005,\, -0.8390,\, -0.1555,\, 1.09,\, 1.08).
#    \tag{3.20} $$
#
# The paper leaves open the number $m$ of correlations, how $c$ is formed, and whether the two inputs are drawn
# independently. All readings follow, beside separable least squares on the same two records.

# %%
report.example_2_bands(results)

# %%
report.example_2_table(results)

# %%
report.example_2_plausibility(results)

# %% [markdown]
# ### The worked nonlinearities

# %%
report.worked(results)

# %% [markdown]
# Two notes. The two-sided preload "as printed" is biased, because the third input (3.10) has a nonzero mean; the
# repair takes $a_2 - a_1$ from the offset of the output under a symmetric input. And an even map has $q = 0$ under
# every even distribution (Remark 3.2); the non-even distributions (3.7) identify it.
#
# ## Printing errors
#
# Each printed form is held against an independent evaluation: quadrature, simulation or finite differences. A form
# that lost a symbol is read in the most favourable way.

# %%
report.errata(results)

# %% [markdown]
# ### What is right

# %%
report.confirmed(results)

# %% [markdown]
# ## Claims

# %%
display.claims(results, "bai")

# %% [markdown]
# ## Gates

# %%
display.gates(results, "bai")

# %% [markdown]
# ## Monte-Carlo studies in full

# %%
report.studies(results)
