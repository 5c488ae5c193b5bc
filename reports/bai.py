# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Bai (2002): linear systems with hard input nonlinearities
#
# The paper identifies a stable linear system behind a hard nonlinearity of known structure: a preload, a
# dead zone, a saturation, a relay, a relay with hysteresis, a hysteresis. The nonlinearity has one unknown
# constant $a$, and the signal $x(k)$ between the two blocks cannot be measured. Two methods are given:
# separable least squares, which leaves a search over $a$ alone, and a correlation method for static
# nonlinearities with several unknown constants. This chapter repeats every figure the paper prints and
# asks of each whether the protocol supports it.

# %% [markdown]
# ## The system
#
# The linear block has the transfer function
#
# $$
# H(z) = \frac{\beta_1 z^{-1} + \beta_2 z^{-2} + \cdots + \beta_n z^{-n}}
#             {1 - \alpha_1 z^{-1} - \alpha_2 z^{-2} - \cdots - \alpha_n z^{-n}},
# \tag{1.1, corrected}
# $$
#
# so that with the output $y(k)$, the noise $v(k)$ and $\theta^\top = (\alpha_1, \dots, \alpha_n, \beta_1,
# \dots, \beta_n)$
#
# $$
# y(k) = \bigl( y(k-1), \dots, y(k-n),\; x(k-1), \dots, x(k-n) \bigr)\, \theta + v(k),
# \tag{2.1}
# $$
#
# $$
# x(k) = \mathcal{N}\bigl(u(k), \dots, u(0), a\bigr).
# \tag{1.3}
# $$
#
# The gain of every nonlinearity is one: any other gain belongs to $\beta_1, \dots, \beta_n$. The figure
# below draws the maps as they are implemented; the two nonlinearities with hysteresis are shown both with
# the rule the paper prints and with the physical one (the Schmitt trigger that holds its state, the play
# operator).

# %% [markdown]
# ## Separable least squares
#
# For a trial value $\hat a$ the signal $\hat x(k)$ is known, the prediction error is linear in
# $\hat\theta$, and
#
# $$
# J = \frac{1}{N} \sum_{k=1}^{N} e_{\hat a}^2(k) = \frac{1}{N} \left\| Y - A(\hat a)\, \hat\theta \right\|^2.
# \tag{2.4, 2.6}
# $$
#
# The best $\hat\theta$ for this $\hat a$ is a least-squares solution; put back, it leaves a function of
# one variable,
#
# $$
# J(\hat a) = \frac{1}{N} \left\| \left( I - A(\hat a) \left[ A(\hat a)^\top A(\hat a) \right]^{-1}
#             A(\hat a)^\top \right) Y \right\|^2,
# \tag{2.9}
# $$
#
# whose global minimum is sought. The matrix in (2.9) is a projector and is computed from a QR
# factorisation of $A(\hat a)$; the inverse is never formed. Between two neighbouring values of $|u(k)|$
# the regressors are affine in $\hat a$ (preload, dead zone, saturation) or constant (the relays), so the
# search goes through these cells one by one and misses none.

# %% [markdown]
# ## Example 1 and Table 1
#
# The example is
#
# $$
# y(k) = \alpha_1 y(k-1) + \alpha_2 y(k-2) + \beta_1 x(k-1) + \beta_2 x(k-2) + v(k)
# $$
#
# with $\theta^\top = (-0.8333, -0.1667, 1, 1)$, $a = 1$, $N = 100$, an input uniform in $[-4, 4]$ and
# independent noise in $[-0.2, 0.2]$.

# %% [markdown]
# ## Figures 1 to 3
#
# Figures 1 and 2 of the paper show the block diagram and the nonlinearities; its figure 3 shows $J(\hat
# a)$ for each of them.

# %% [markdown]
# ## Monte-Carlo study
#
# One data set says little. The same protocol, repeated with fresh inputs and noise, gives bias, spread and
# the 95 % band of each parameter, and the ratio of its variance to the asymptotic bound of least squares.

# %% [markdown]
# ## Is the printed table plausible?
#
# Each printed row is compared with the Monte-Carlo distribution of its own case: parameter by parameter
# with the 95 % band, and as a whole by its Mahalanobis distance
#
# $$
# d^2 = (\hat\eta - \bar\eta)^\top C^{-1} (\hat\eta - \bar\eta), \qquad
# \hat\eta^\top = (\hat a, \hat\alpha_1, \hat\alpha_2, \hat\beta_1, \hat\beta_2),
# $$
#
# where $\bar\eta$ and $C$ are mean and covariance over the runs. The six rows together are judged as a
# set.

# %% [markdown]
# ## Consistency
#
# The paper argues that the estimates are consistent. Here the root mean square error is shown over $N$: a
# slope of $-1/2$ on logarithmic axes where the cost is smooth enough, and a slope of $-1$ for $\hat a$ of
# the relays, whose output jumps at $|u| = a$, so that the estimate is as precise as the gap between
# neighbouring samples.

# %% [markdown]
# ## The correlation method and Example 2
#
# With a zero-mean independent input, $w(i) = \mathrm{E}\, y(k) u(k-i)$ and $q = \mathrm{E}\, x(k) u(k)$,
# the system gives linear equations for $\alpha_i$ and $q\beta_j$,
#
# $$
# \begin{pmatrix} w(1) \\ \vdots \\ w(n) \\ w(n+1) \\ \vdots \\ w(m) \end{pmatrix}
# =
# \begin{pmatrix}
# 0 & \cdots & 0 & 1 & \cdots & 0 \\
# \vdots & \ddots & \vdots & \vdots & \ddots & \vdots \\
# w(n-1) & \cdots & 0 & 0 & \cdots & 1 \\
# w(n) & \cdots & w(1) & 0 & \cdots & 0 \\
# \vdots & \ddots & \vdots & \vdots & \ddots & \vdots \\
# w(m-1) & \cdots & w(m-n) & 0 & \cdots & 0
# \end{pmatrix}
# \begin{pmatrix} \alpha_1 \\ \vdots \\ \alpha_n \\ q\beta_1 \\ \vdots \\ q\beta_n \end{pmatrix}.
# \tag{3.3}
# $$
#
# Identification with $l + 1$ input distributions $f_1, \dots, f_{l+1}$ gives the ratios $c_i$ and from
# them $l$ equations for the unknown $a \in \mathbb{R}^l$,
#
# $$
# c_i\, q(f_{i+1}, a) = q(f_1, a), \qquad i = 1, \dots, l.
# \tag{3.5}
# $$
#
# For the saturation and two uniform inputs in $[-b_i, b_i]$ with $b_i > a$, the moment is $q(f_i, a) =
# \frac{a}{b_i} \bigl( \frac{b_i^2}{2} - \frac{a^2}{6} \bigr)$, and
#
# $$
# a = \sqrt{ \frac{3\, (c_1 b_2 - b_1)\, b_1 b_2}{c_1 b_1 - b_2} }.
# \tag{3.14}
# $$
#
# The paper takes the absolute value below the root. A negative argument means that the estimated ratio
# $c_1$ is one that no $a$ can give; such runs are counted here rather than hidden.

# %% [markdown]
# ## Errata
#
# Each correction is shown with the printed form and the corrected form against quadrature.

# %% [markdown]
# ## Gates
