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
from sysid.reporting import display

results = display.load()

# %% [markdown]
# ## Chapter 4: separable least squares with splines

# %% [markdown]
# ## Chapter 5: piecewise affine maps

# %% [markdown]
# ## Claims

# %%
display.claims(results, "pepona")

# %% [markdown]
# ## Gates

# %%
display.gates(results, "pepona")
