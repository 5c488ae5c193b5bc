# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Lacy, Erwin, Bernstein: Wiener systems with known noninvertible nonlinearities
#
# S. L. Lacy, R. S. Erwin, D. S. Bernstein, *Identification of Wiener systems with known noninvertible
# nonlinearities*, ASME Journal of Dynamic Systems, Measurement, and Control 123(4), 2001. A linear system is seen
# through a static map that is known but cannot be inverted: a sine, a dead zone, a quantiser, a sign. The paper
# looks for the intermediate signal in the preimage of the data, by least squares.
#
# What we find: the method works, and better than its four pictures can show. Behind the sine the search over
# $10^{12}$ sequences, which the paper calls finite, can be done exactly in a fraction of a second. Behind sign the
# printed criterion has a useless minimum at zero; a scale-free one repairs it. With noise the method is
# not consistent, because its regressors carry the noise; maximum likelihood for the same model, started from the
# preimage estimate, comes close to the Cramér-Rao bound with 20 to 60 samples.
# Seven things are printed wrongly; each is proved wrong, and its correction right, by a number.

# %%
from replications.lacy import report
from sysid.reporting import display

results = display.load()

# %% [markdown]
# ## The structure
#
# The system is, with the noise where the examples have it,
#
# $$ y(k) = \frac{b_0 + b_1q^{-1} + \dots + b_nq^{-n}}{1 + a_1q^{-1} + \dots + a_nq^{-n}}\,u(k), \qquad
#    z(k) = \mathcal N\bigl(y(k) + w(k)\bigr). \tag{1, 30} $$

# %%
report.block_diagram()

# %% [markdown]
# All examples use one lightly damped oscillator,
#
# $$ G = \frac{0.4450\,q + 0.4299}{q^2 - 1.0300\,q + 0.9048}. \tag{29} $$

# %%
report.literal_reading(results)

# %% [markdown]
# ## The criterion
#
# For a given $y$ the parameters follow by least squares. What remains depends on $y$ alone,
#
# $$ J_y(u, y) = \min_\theta \|Qy - \Phi(u, y)\theta\| = \|\Pi^\perp_{\Phi}\,Qy\| , \tag{13} $$
#
# and is minimised over the preimage $\mathcal N^{-1}(z)$. At the minimum over $\theta$ the derivative by $\theta$
# vanishes, so the gradient needs no derivative of a projector. With the residual $r$ and the matrix $A(\theta)$ of the
# filter $1 + a_1q^{-1} + \dots$ it is
#
# $$ \frac{\partial J_y^2}{\partial y} = 2A(\hat\theta)^Tr, \qquad
#    \frac{\partial^2 J_y^2}{\partial y\,\partial y^T} = 2\bigl(A^TA - WW^T\bigr), $$
#
# with $W = SR^{-1} - A^TQ_1$ of $2n+1$ columns, where $\Phi = Q_1R$ and $S$ holds $r$ shifted by each lag. This is (22)
# and (23), repaired, at the cost of a filter.

# %%
report.derivatives(results)

# %% [markdown]
# ## Four kinds of preimage
#
# The preimage of each datum is a finite union of points and intervals, a property of the nonlinearity. What it is made of
# decides how the criterion is minimised: one point a datum is one evaluation; intervals are a box, searched by
# bounded descent with the gradient above from several starts; several points a datum are a finite set, searched
# exactly; both together are examined region by region.

# %%
report.special_cases(results)

# %% [markdown]
# The finite sets look hopeless, as the regions multiply: $4^{20}$ for the sine. But samples can be fixed one after
# another. Each adds one row to the regression, a Givens rotation carries the triangular factor along, and the partial
# sum of squares never falls. So a branch ends as soon as it exceeds the best complete sequence.

# %%
report.search(results)

# %% [markdown]
# ## Scale
#
# If every part of the preimage around zero is a cone or holds zero, $y$ can be shrunk without leaving it, and
# $J_y$ falls to zero with it. The fit therefore minimises $J_y^2/\|Qy\|^2$ over boxes, and refuses data
# which $y = 0$ explains.

# %%
report.scale(results)

# %%
report.identifiability(results)

# %% [markdown]
# ## The four examples
#
# Input and noise are normal, the noise scaled to $\|y - \bar y\|/\|w\| = 10$. The paper does not print the width of its
# dead zone, the step of its quantiser and the domain of its sine; here they are $\pm1$, $1$ and $[-2\pi, 2\pi]$, and the
# system starts from rest. Each pair of figures shows one record, drawn once and not selected.
#
# ### Example 1: sine

# %%
report.example(results, "sine")

# %%
report.branch_recovery(results)

# %% [markdown]
# ### Example 2: dead zone

# %%
report.example(results, "dead-zone")

# %% [markdown]
# ### Example 3: quantisation

# %%
report.example(results, "quantisation")

# %% [markdown]
# ### Example 4: sign

# %%
report.example(results, "sign")

# %% [markdown]
# ## Not one record but many
#
# One picture of one record cannot tell luck from method. Maximum likelihood takes the datum for what it says: that
# $y + w$ lies in its preimage. A point counts with its density, several points with their sum, an interval with its
# probability; the initial state is free and the noise level is estimated (behind sign it is the unit). It
# starts from the preimage estimate, for the sine from the ten best sequences.

# %%
report.spread(results)

# %%
report.methods(results)

# %%
report.peaks(results)

# %%
report.window(results)

# %% [markdown]
# ### Without noise

# %%
report.noise_free(results)

# %% [markdown]
# ## Is it consistent?
#
# The method minimises an equation error. With noise before the nonlinearity its regressors are $y + w$: least squares with
# noisy regressors is biased however long the record is, even with no nonlinearity at all. Maximum likelihood uses
# the free run of the model, and its error falls with the bound.

# %%
report.consistency(results)

# %%
report.bias(results)

# %%
report.efficiency(results)

# %% [markdown]
# ## Data outside the range

# %%
report.outside(results)

# %% [markdown]
# ## Section 6: an unknown nonlinearity
#
# Step tests show $\mathcal N(G(1)u)$. As gain can be moved between the blocks, $G(1) = 1$ is taken, which by (28) removes
# $b_0$. The paper gives no figures for this; here are some.

# %%
report.step_tests(results)

# %% [markdown]
# ## Printing errors
#
# A form that lost a symbol is read in the most favourable way.

# %%
report.errata(results)

# %% [markdown]
# ## Claims

# %%
display.claims(results, "lacy")

# %% [markdown]
# ## Gates

# %%
display.gates(results, "lacy")

# %% [markdown]
# ## Monte-Carlo studies in full

# %%
report.studies(results)
