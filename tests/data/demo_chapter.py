# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # A demonstration: $J(\hat a)$ & <friends>
#
# Everything a chapter may hold, with text that is unkind to both outputs: `<script>alert("x")</script>`,
# #typst, \$5 and \$6, snake_case_names, a*b*c, @label, ~tilde, [brackets], `code` and *emphasis* with
# **strong words**. Inline mathematics sits on the baseline: $\hat a = \arg\min_a J(a)$ with
# $\theta^\top = (\alpha_1, \dots, \beta_n)$, $\frac{1}{N}$ and $\sqrt{2}$. See [the equations](#equations).

# %%
from sysid.reporting import display as show

results = show.load()

# %% [markdown]
# ## Equations
#
# The cost after elimination of the linear parameters is
#
# $$
# J(\hat a) = \frac{1}{N} \left\| \left(I - A(\hat a)\left[A(\hat a)^\top A(\hat a)\right]^{-1} A(\hat a)^\top\right) Y \right\|^2,
# \tag{2.9}
# $$
#
# and a nonlinearity with its cases and a matrix are
#
# $$ x(k) = \begin{cases} u(k) - a & u(k) > a, \\ 0 & |u(k)| \le a, \\ u(k) + a & \text{otherwise,} \end{cases} $$
#
# $$
# \begin{pmatrix} w(1) \\ \vdots \\ w(m) \end{pmatrix} = \Sigma \begin{pmatrix} \alpha_1 \\ \vdots \\ q\beta_n \end{pmatrix},
# \qquad \Sigma = \begin{pmatrix} 0 & 0 & \cdots & 1 \\ w(1) & 0 & \cdots & 0 \\ w(m-1) & w(m-2) & \cdots & 0 \end{pmatrix}
# \tag{3.3}
# $$
#
# $$
# \begin{aligned} \dot x &= \operatorname{sgn}(u) - x, \\ y &= \sum_{k=1}^{N} x_k^2 \end{aligned}
# $$
#
# ### Lists and quotations
#
# 1. First, with $\alpha$.
# 2. Second:
#    - nested <b>item</b>,
#    - another.
#
# - plain
# - list
#
# > A quotation with $\beta_1$.
#
# | Quantity | Value | Remark |
# |:--|--:|:-:|
# | $a$ | 1.0 | `exact` |
# | $\sigma$ | 0.12 | **half** |
#
# ```python
# x = sysid.identify(record)["a"]  # $not math$ #typst
# ```
#
# ---

# %% [markdown]
# ## Claims

# %%
with show.style():
    figure, axes = show.subplots(1, 2, height=2.8)
    grid = [i / 50 for i in range(176)]
    for number, offset in enumerate((0.0, 0.4, 0.8)):
        axes[0].plot(grid, [abs(a - 1) + offset + 0.1 * (a % 0.5) for a in grid], label=f"case {number + 1}")
    axes[0].set_xlabel(r"$\hat a$")
    axes[0].set_ylabel(r"$J(\hat a)$")
    axes[0].legend()
    for number in range(3):
        axes[1].loglog([100, 400, 1600], [10 ** (-number) / n**0.5 for n in (100, 400, 1600)],
                       **show.series(number, marker=True))
    axes[1].set_xlabel("N")
    axes[1].set_ylabel("RMSE")
picture = show.figure(
    figure,
    r"Cost $J(\hat a)$ over $\hat a$, and RMSE over $N$ <for> #three_cases.",
    "The minimum lies at the kink; the slopes are $-1/2$.",
)
show.claim(results, "demo", "table-1/preload/a", picture)

# %%
show.claim(results, "demo", "nasty_$id$ *x*")

# %%
show.claims(results, "demo")

# %% [markdown]
# ## Monte-Carlo

# %%
show.monte_carlo(results, "demo", "preload")

# %%
rows = [["pre_load <b>", 1, 0.123456789, None, show.Markdown(r"$\frac{a}{b}$")],
        ["#dead*zone*", 12345678, -1.5e-9, float("nan"), show.Verdict("passed", "passed")]]
show.table(rows, ["Case", "Count", "Value", "$x^2$", "Mark"], caption="A table of *oddities* with $x_1$.",
           formats={"Value": ".2e"})

# %%
show.group(
    show.prose(f"There were **{len(results['papers']['demo']['gates'])}** gates."),
    show.facts({"seed": 1, "nothing": None, "list": [1.0, 2.5]}),
)

# %%
print("plain output <pre> & #such")

# %% [markdown]
# ## Gates

# %%
show.gates(results, "demo")
