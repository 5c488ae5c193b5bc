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
# E. Pepona, *Identification of nonlinear interconnected systems*, doctoral thesis, Brunel University, 2009. A linear
# system is joined to one static map of unknown form. Chapter 4 takes a spline for the map and separates the
# parameters in which the prediction is linear; Chapter 5 takes a piecewise affine map.

# %%
from replications.pepona import chapter4_report as chapter_4
from replications.pepona import chapter5_report, records_report
from sysid.reporting import display

results = display.load()

# %% [markdown]
# ## Chapter 4: separable least squares with splines
#
# What we find: the method works, and attains the bound of its model from 1000 samples on. Tables 4.3 and 4.4 are
# replicated once the signs are right, which the print has wrong in both systems; Table 4.2 cannot come from the
# 1000 samples of the text. The VAF of Example 4.3 is a one-step prediction, that of Example 4.4 a free run.
# The iteration of Table 4.1 stops at the first step that works, and the rank condition of Lemma 4.1 can only hold
# where $n_g = 0$; neither is needed.

# %%
chapter_4.block_diagram()

# %% [markdown]
# The model is
#
# $$ A(q)y_k = B(q)u_k + G(q)w_k + e_k, \qquad z_k = D(q)u_k, \qquad
#    w_k = \sum_{j=1}^{s}\lambda_j|z_k-\kappa_j|^m + \lambda_{s+1}z_k + \lambda_0, \tag{4.10} $$
#
# with $g_0 = 1$ and $\|d\| = 1$. The prediction is linear in $a$, $b$, $\lambda$ and nonlinear in $d$, $g$, so that
# the former are eliminated: $V_{SN}(d, g)$ of (4.29) is the shared criterion of this library.

# %% [markdown]
# ### The separated problem and the joint one

# %%
chapter_4.theorem_1(results)

# %%
chapter_4.conditions(results)

# %% [markdown]
# The knots are equally spaced over the range of $z$, which turns with $d$; their motion is part of the derivative.
# Outside the knots the map goes on as a straight line, never as a cubic. B-splines span the same maps as the printed
# basis.

# %%
chapter_4.bases(results)

# %% [markdown]
# ### The iteration of Table 4.1

# %%
chapter_4.iteration(results)

# %%
chapter_4.searches(results)

# %% [markdown]
# ### What the constraints fix and what stays open

# %%
chapter_4.identifiability(results)

# %%
chapter_4.shift(results)

# %% [markdown]
# ### Consistency

# %%
chapter_4.lemma(results)

# %% [markdown]
# ### Example 4.2: a Wiener system
#
# $y_k = z_k/\sqrt{0.1 + 0.9z_k^2} + e_k$ with three taps. As $y$ has no memory, one-step VAF and free-run VAF are the
# same.

# %%
chapter_4.example_table(results, "4.2")

# %%
chapter_4.fewer_samples(results)

# %%
chapter_4.map_of(results, "4.2", "4.1")

# %% [markdown]
# ### Example 4.3: a Wiener-Hammerstein system
#
# $y_k = a_1y_{k-1} + w_k + g_1w_{k-1} + e_k$, $w_k = \arctan(z_k - 1)$. Table 4.3 prints $a_1 = -0.4$, and every
# sign of the two coefficients was tried:

# %%
chapter_4.signs(results, "4.3")

# %% [markdown]
# Only $+0.4\,y_{k-1}$ with $-0.5\,w_{k-1}$ agrees with both printed figures. So the $a_1$ of Table 4.3 is that of
# $A(q)$, except for its initial value, which has the sign of (4.33).

# %%
chapter_4.example_table(results, "4.3")

# %%
chapter_4.initialisation(results)

# %%
chapter_4.stages(results)

# %% [markdown]
# ### Example 4.4: a map in the loop
#
# $y_k = a_1y_{k-1} + b_1u_{k-1} + w_k + g_1w_{k-1} + e_k$, $w_k = |z_k - 2| + 0.8\arctan z_k$, and $z_k = y_{k-2}$,
# which is not in (4.10b) but fits the same algebra, as $z$ is measured. As printed the system diverges.

# %%
chapter_4.signs(results, "4.4")

# %% [markdown]
# With $+0.5\,w_{k-1}$ the system diverges sooner or later, whatever the sign of $a_1$. Of the two systems that never do,
# the one with $+0.4\,y_{k-1}$, as in (4.41a), has free runs like the printed VAF, and the other has not. So one sign is
# wrong, that of $g_1$; and with it the system is that of Example 4.3 but for the loop.

# %%
chapter_4.example_table(results, "4.4")

# %%
chapter_4.map_of(results, "4.4", "4.4")

# %% [markdown]
# ### Which VAF is printed

# %%
chapter_4.vaf(results)

# %%
chapter_4.vaf_table(results)

# %% [markdown]
# ### The examples in full

# %%
chapter_4.studies(results)

# %% [markdown]
# ## A real circuit: the Wiener-Hammerstein benchmark
#
# A diode between two linear filters (SYSID 2009), 178 800 samples. Both linear parts have poles, and the error that
# counts is that of the free run, so the machinery of Chapter 4 is extended: the map stays a spline that is eliminated
# linearly, while the poles of both blocks are searched from many starts. It takes minutes and is run by
# `sysid replicate pepona --with-records`.

# %%
records_report.benchmark(results)

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
# ## Printing errors

# %%
chapter_4.errata(results)

# %% [markdown]
# ## Claims

# %%
display.claims(results, "pepona")

# %% [markdown]
# ## Gates

# %%
display.gates(results, "pepona")
