# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Pepona: linear fractional transformations with splines and piecewise affine maps
#
# E. Pepona, *Identification of nonlinear interconnected systems*, doctoral thesis, Brunel University, 2009.

# %%
from replications.pepona import chapter5_report
from sysid.reporting import display

results = display.load()

# %% [markdown]
# ## Chapter 4: separable least squares with splines

# %% [markdown]
# ## Chapter 5: piecewise affine maps
#
# The map may jump. A linear part of known orders surrounds it,
#
# $$ A(q)\,y_k = B(q)\,u_{k-n_k} + G(q)\,w_k + \varepsilon_k, \qquad w_k = f(z_k), \tag{5.5} $$
#
# with $g_0 = 1$ and $f(z) = \theta_i^T[z^T\;1]^T$ in region $i$. The scheme of Table 5.1 recovers $w$ from the data and
# the linear part, fits a map to it, then the linear part to the map's output, and so on.
#
# What we find: the scheme works with any of three map stages, and the bounded-error stage of the text is the least
# sure of them. It is biased where $z$ holds lagged outputs and $n_g > 0$, as in Examples 5.2 and 5.3. A last joint step
# over all parameters and the boundaries removes the bias and reaches the Cramér-Rao bound of a known partition. Lemma 5.1
# is neither necessary nor sufficient as printed; the exact condition is a rank.

# %% [markdown]
# ### Identifiability

# %%
chapter5_report.identifiability(results)

# %% [markdown]
# ### Recovering the signal before a moving average
#
# With $\varepsilon = 0$ (5.21) has $n_g$ unknowns more than equations. The solution of least norm, by the Cholesky factor of
# a band, costs $O(N n_g^2)$ and stays bounded wherever the zeros of $G$ lie; a recursion does not.

# %%
chapter5_report.smoothing(results)

# %% [markdown]
# ### Example 5.1 (5.25): a kink

# %%
chapter5_report.first_iteration(results)

# %%
chapter5_report.creeping(results)

# %%
chapter5_report.estimates(results, "5.1")

# %% [markdown]
# The joint fit knows that the map is continuous: the boundary is then where the submodels meet, and has an error of its
# own.
#
# ### Example 5.2: a jump, and output in the map

# %%
chapter5_report.sequence(results, "5.2")

# %%
chapter5_report.estimates(results, "5.2")

# %%
chapter5_report.table_5_3(results)

# %% [markdown]
# ### Example 5.3: nothing but the map and its echoes

# %%
chapter5_report.clouds(results)

# %%
chapter5_report.sequence(results, "5.3")

# %%
chapter5_report.estimates(results, "5.3")

# %% [markdown]
# ### The bias of alternating
#
# The recovered signal is $v = w + e/G(q)$. Its noise is coloured by $1/G(q)$ and so correlated with lagged outputs in
# $z$: least squares of $v$ on $z$ is biased. The joint step minimises the prediction error itself, whose noise is white.
# With the modes of all samples given the problem is separable, linear but for $g$; with the parameters given the
# boundary is moved along lines on which every cell is examined. Both are repeated until no sample changes its mode.

# %%
chapter5_report.bias(results)

# %% [markdown]
# ### Map stages and the stopping threshold

# %%
chapter5_report.stages(results)

# %%
chapter5_report.thresholds(results)

# %% [markdown]
# ### The same systems without their structure

# %%
chapter5_report.pwarx(results)

# %% [markdown]
# ## Claims

# %%
display.claims(results, "pepona")

# %% [markdown]
# ## Gates

# %%
display.gates(results, "pepona")
