# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Borges, Verdult, Ayala Botto: composite local linear models by separable least squares
#
# J. Borges, V. Verdult, M. Ayala Botto, *Efficient implementation of separable least squares for the identification of
# composite local linear state-space models*. A few linear models take turns, by weights that depend on the input. The
# paper eliminates the parameters that enter linearly and asks how to compute the derivative of what is left.
#
# What we find: the elimination is worth it, and the cheapest of the three derivatives, 2b, has the right gradient. But it
# is not the Jacobian that the paper says it is, and Levenberg-Marquardt pays for that where there is little noise. The
# right Jacobian costs little more: Kaufman's by a projection of 2b, and the exact one by sensitivities of the adjoint
# system, without any derivative of the regressors. Projected gradients change nothing once the Jacobian is right. The
# model with the printed number of parameters cannot fit the second output of the example; one more scheduling input can.

# %%
from replications.borges import report
from sysid.reporting import display

results = display.load()

# %% [markdown]
# ## The structure
#
# $$ x_{k+1} = \sum_{i=1}^s p_i(\phi_k) (A_i x_k + B_i u_k + O_i), \qquad y_k = C x_k + v_k \tag{1, 2} $$
#
# $$ p_i = \frac{r_i}{\sum_j r_j}, \qquad r_i = \exp\left(-(\phi - c_i)^T \mathrm{diag}(w_i)^2 (\phi - c_i)\right)
#    \tag{3, 4} $$

# %%
report.structure()

# %% [markdown]
# From $x_0 = 0$ the output is linear in $G = [B_1\, O_1 \dots B_s\, O_s]$: $\hat Y = \Phi(\eta)\theta_\ell$. The columns
# of $\Phi$ are outputs of systems that share $\mathcal A_k = \sum_i p_i A_i$, and so are all sensitivities, forwards and
# backwards: one batch recursion, kept in registers, computes everything in this chapter. It agrees with the printed
# Kronecker formula (8), put in the right order of time, to the last digits.
#
# ## Which derivative is the Jacobian
#
# The projected residual $\tilde E = (I - P)Y$ has the derivative (28). The paper replaces it by the derivative of $E$ at
# a fixed $\hat\theta_\ell$, (37) and (39). Finite differences decide.

# %%
report.jacobians(results)

# %% [markdown]
# The second term of (28) needs $(\partial\Phi/\partial\eta_j)^T\tilde E$ only. $\Phi^T\tilde E$ is the gradient of
# $\tilde E^T\hat Y$ by $G$, which one backward pass of the adjoint gives; its derivative by $\eta$ takes as many backward
# passes as there are parameters in $\eta$, in place of $ns(m+1)$ times as many forward ones.

# %%
report.searches(results)

# %% [markdown]
# ## What is redundant

# %%
report.redundancy(results)

# %% [markdown]
# ## The example
#
# $$ y^{(1)}_{k+1} = \frac{0.8 (y^{(1)}_k)^3 + (u^{(1)}_k)^2 u^{(2)}_k}{2 + (y^{(2)}_k)^2}, \qquad
#    y^{(2)}_{k+1} = \frac{y^{(1)}_k + y^{(1)}_k y^{(2)}_k + (u^{(1)}_{k-1} - 0.5)(u^{(2)}_k + 0.8)}{2 + (y^{(2)}_k)^2} $$

# %%
report.inputs(results)

# %%
report.scores_figure(results)

# %%
report.scores(results)

# %% [markdown]
# ## Operations and times

# %%
report.table_1(results)

# %%
report.table_2(results)

# %% [markdown]
# ## Long records

# %%
report.long_records(results)

# %% [markdown]
# ## Printing errors
#
# Each printed form is held against an independent evaluation.

# %%
report.errata(results)

# %% [markdown]
# ## Claims

# %%
display.claims(results, "borges")

# %% [markdown]
# ## Gates

# %%
display.gates(results, "borges")
