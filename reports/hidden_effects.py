# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Which effect is missing?
#
# A diagnosis that names what is missing in a model can only be trusted if it was tried where the truth is known. Here
# a random plant is drawn, an effect is hidden in it, the output is measured with noise, and `sysid diagnose` is
# asked, in the form a user would, which of some twenty candidates is there. The simulators share no code with the
# models that are fitted; the test rows are handed over without their output.
#
# The strength of the effect is set so that a linear model leaves a wanted share of the output's variance
# unexplained: 3 to 30 % in the tier *normal*, with white noise at 20 to 40 dB; 1 to 8 % in the tier *hard*, with
# coloured noise at 10 to 20 dB. Of a hundred cases 64 hide one effect, 14 nothing, 10 two effects and 12 an effect
# that is not among the candidates, so that the only right answer is that none of them explains the record.

# %%
from benchmarks.hidden_effects import chapter
from sysid.reporting import display

results = display.load()

# %% [markdown]
# ## How often is the answer right?

# %%
chapter.scores(results)

# %% [markdown]
# A case without an answer counts as wrong. Intervals are Wilson's. The error reduction compares the fall of the
# free-run error on the test rows, against the noise-free output, with the fall that the true structure achieves when
# it is simulated by its own simulator and fitted to the same rows from the true values.

# %%
chapter.errors(results)

# %% [markdown]
# ## How small an effect is seen?

# %%
chapter.power(results)

# %% [markdown]
# ## What is taken for what?

# %%
chapter.effects(results)

# %%
chapter.families(results)

# %% [markdown]
# ## Can the numbers be believed?
#
# Where nothing is missing, a p-value below $\alpha$ should come up with frequency $\alpha$. The p-value reported is
# family-wise: it allows for the search over all candidates and their parameters.

# %%
chapter.p_values(results)

# %%
chapter.intervals(results)

# %% [markdown]
# ## What other tools do with the same records
#
# The comparison is not between equals. The diagnosis is told the family of the model and a list of candidates with
# the true one mostly among them; a sparse library fit, the selection of polynomial terms and a black-box network are
# told neither. They are built to predict, not to name a cause, and may be run better by those who know them well.
# What can be compared is the free-run error, and whether the answer says anything an engineer could act on.

# %%
chapter.peers(results)

# %% [markdown]
# ## Time

# %%
chapter.times(results)
