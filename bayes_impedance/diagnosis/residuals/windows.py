r"""Scan statistics over windows of frequency: structure that all people share, and structure that differs.

A template w lives in one window and in one half of the vectors of :mod:`~bayes_impedance.diagnosis.residuals.nodes`,
magnitude or phase. Its score in a recording, :math:`s_r = w^T x_r`, has the variance :math:`v_r = w^T C_r w`: it is the
matched filter of the projected template, so the projection is accounted for.

**Coherent.** With i for persons, :math:`z = \sum s_i / \sqrt{\sum v_i}` and
:math:`\phi = (\sum s_i^2/v_i - z^2)/(N - 1)`, the scatter between persons in units of the noise's,

.. math:: c = z / \sqrt{\max(1, \phi)}

is large only where the population's *mean* residual is. Structure of random sign, or a noise level that was taken too
small, does not make it large.

**Incoherent.** The ratio of :math:`\phi` to the same quantity for contrasts between repetitions is F distributed,
whatever the shape of the noise over frequency. The energy of all points of a window gives a second such ratio, for
structure at a different place in each person. Ratios are compared on the scale of a standard normal (Wilson and
Hilferty's cube root).

**Many windows.** The distribution of either maximum comes from Monte-Carlo draws with the population's covariance. Far
in the tail, :math:`p = M(t)\,P(|N| > t)` with an effective number of windows M that is calibrated at 5 % and grows as
t^2, as it does for a smooth field over position and width, up to the number of all templates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayes_impedance.diagnosis.residuals.nodes import Pooled, contrast_matrix

_SMALLEST_WINDOW, _SHAPED_WINDOW = 3.0, 6
"""Points in the narrowest window, and in the narrowest that is also searched for a slope and for a bend. By choice:
three points average single ones; six are twice the three terms constant, slope and bend."""

_ABSORBED = 0.05
"""Smallest part of a template's energy that the elements may leave: with less, the linear theory of the remainder is
unreliable. By choice."""

_CALIBRATED_AT = 0.05
"""Upper tail probability of the null draws beyond which p-values follow the tail of a normal field. By choice: of 500
draws the tail is then calibrated on 25."""

_TEMPLATES_AT_ONCE = 256
"""Templates whose draws are in memory at once. By choice: with 500 draws an array of them takes a megabyte."""

_INDISTINCT, _ALIKE = 2.0, 6.0
"""Chi-square by which a narrower window may be worse, with the same shape and with another. By choice; the second is
larger because elements absorb much of what distinguishes a constant from a slope over a wider window."""


@dataclass(frozen=True, kw_only=True)
class Windows:
    """Windows of log frequency and the templates in them.

    Attributes
    ----------
    low, high : ndarray of int, shape (B,)
        Nodes low <= k < high.
    inside : ndarray, shape (G, B)
        1 inside the window, else 0.
    window, form : ndarray of int, shape (T,)
        Window of each template, and whether it is a constant (0), a slope (1) or a bend (2).
    shape : ndarray, shape (G, T)
        A constant in each window, and a slope and a bend in those wide enough; unit norm.
    """

    low: np.ndarray
    high: np.ndarray
    inside: np.ndarray
    window: np.ndarray
    form: np.ndarray
    shape: np.ndarray

    def home(self) -> np.ndarray:
        """Window, of those in magnitude and then those in phase, of each template in `templates`, shape (2 T,)."""
        return np.concatenate([self.window, self.window + self.low.size])

    def templates(self) -> np.ndarray:
        """All templates in magnitude, then in phase, shape (2 G, 2 T)."""
        zero = np.zeros_like(self.shape)
        return np.block([[self.shape, zero], [zero, self.shape]])


def windows(frequency_hz: np.ndarray) -> Windows:
    """Windows of 1, 1/2, 1/4, ... of the range of log frequency, a quarter of their width apart."""
    x = np.log(frequency_hz)
    g, span = x.size, float(x[-1] - x[0])
    # Only every other window is also searched for slopes and bends: their positions matter less than edges do.
    found, pieces = {(0, g): True}, 2
    while g / pieces >= _SMALLEST_WINDOW:
        start = x[0] + 0.25 * span / pieces * np.arange(4 * pieces - 3)
        low = np.searchsorted(x, start - 1e-9 * span).tolist()
        high = np.searchsorted(x, start + span / pieces + 1e-9 * span, side="right").tolist()
        for k, edges in enumerate(zip(low, high, strict=True)):
            found[edges] = found.get(edges, False) or k % 2 == 0
        pieces *= 2
    ends = sorted(e for e in found if e[1] - e[0] >= min(_SMALLEST_WINDOW, g))
    inside = np.zeros((g, len(ends)))
    shapes, window, form = [], [], []
    for b, (low, high) in enumerate(ends):
        inside[low:high, b] = 1.0
        for number in range(3 if found[low, high] and high - low >= _SHAPED_WINDOW else 1):
            shapes.append(shape_of(x, low, high, number))
            window.append(b)
            form.append(number)
    all_low, all_high = np.array(ends).T
    return Windows(
        low=all_low,
        high=all_high,
        inside=inside,
        window=np.array(window),
        form=np.array(form),
        shape=np.array(shapes).T,
    )


def shape_of(x: np.ndarray, low: int, high: int, form: int) -> np.ndarray:
    """Constant, slope or bend over the nodes low <= k < high of x (G,): shape (G,), unit norm."""
    shape = np.zeros(x.size)
    u = x[low:high] - 0.5 * (x[low] + x[high - 1])
    u = u / max(float(u[-1]), 1e-12)
    part = (np.ones(high - low), u, 1.5 * u**2 - 0.5)[form]
    shape[low:high] = part / np.linalg.norm(part)
    return shape


@dataclass(frozen=True)
class Ratios:
    """F ratios of the scatter between persons, for templates and then for whole windows.

    Attributes
    ----------
    excess : ndarray, shape (2 T + 2 B,)
        Ratio of the scatter between persons to that of the noise.
    freedom : ndarray, shape (2 T + 2 B,)
        Degrees of freedom of the numerator.
    noise_freedom : ndarray, shape (2 T + 2 B,)
        Degrees of freedom of the denominator; infinite if the noise is assumed.
    noise : ndarray, shape (2 T + 2 B,)
        Scatter of the contrasts between repetitions over what was assumed; 1 if there are none.
    """

    excess: np.ndarray
    freedom: np.ndarray
    noise_freedom: np.ndarray
    noise: np.ndarray


def scatter_ratios(pooled: Pooled, windows: Windows, use_contrasts: bool) -> Ratios:
    """Compare the scatter between persons with the noise, in all templates and windows."""
    templates, inside = windows.templates(), windows.inside
    matrix = contrast_matrix(pooled.owner) if use_contrasts else None
    some = [_of_templates(pooled, own, matrix) for own in _in_pieces(templates)]
    between, freedom, within = np.concatenate(some, axis=1)

    node, n = pooled.node_variance(), pooled.by_person(pooled.count)
    node_sum, all_n = pooled.by_person(pooled.scores), np.maximum(n.sum(axis=0), 1.0)
    n = np.maximum(n, 1.0)
    energy = np.sum(node_sum**2 / n, axis=0) - node_sum.sum(axis=0) ** 2 / all_n
    expected = np.sum(pooled.by_person(node) / n, axis=0) - node.sum(axis=0) / all_n
    top = np.concatenate([between, _in_windows(energy, inside)])
    freedom = np.maximum(np.concatenate([freedom, _in_windows(expected, inside)]), 0.0)
    if matrix is None:
        ones = np.ones(freedom.size)
        return Ratios(top / np.maximum(freedom, 1e-300), freedom, np.full(freedom.size, np.inf), ones)

    n = np.maximum(matrix**2 @ pooled.count, 1.0)
    energy = _in_windows(np.sum((matrix @ pooled.scores) ** 2 / n, axis=0), inside)
    expected = _in_windows(np.sum((matrix**2 @ node) / n, axis=0), inside)
    # All points of a window estimate its noise better than one template does, unless the noise is not white.
    level = energy / np.maximum(expected, 1e-300)
    home = windows.home()
    noise = np.concatenate([np.maximum(within, level[home]), level])
    noise_freedom = np.concatenate([expected[home], expected])
    return Ratios(top / np.maximum(freedom * noise, 1e-300), freedom, noise_freedom, noise)


def _of_templates(pooled: Pooled, templates: np.ndarray, matrix: np.ndarray | None) -> np.ndarray:
    """Chi-square between persons, its degrees of freedom, and noise of the contrasts over what was assumed (3, M)."""
    score, variance = pooled.scores @ templates, pooled.variance(templates)
    between, freedom = _between(pooled, templates, score, variance)
    if matrix is None:
        return np.array([between, freedom, np.ones(between.size)])
    s, v = matrix @ score, matrix**2 @ variance
    usable = v > 1e-6 * (matrix**2 @ (pooled.count @ templates**2)).max(axis=0)
    within = np.sum(np.divide(s**2, v, out=np.zeros_like(s), where=usable), axis=0)
    return np.array([between, freedom, within / np.maximum(usable.sum(axis=0), 1)])


def scatter_between(pooled: Pooled, templates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Chi-square of the scatter between persons for templates (2 G, M), and its degrees of freedom, shape (M,)."""
    return _between(pooled, templates, pooled.scores @ templates, pooled.variance(templates))


def _between(
    pooled: Pooled, templates: np.ndarray, score: np.ndarray, variance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The same as :func:`scatter_between`, from the scores and their variances, shape (R, M)."""
    s, v = pooled.by_person(score), pooled.by_person(variance)
    usable = v > 1e-6 * pooled.by_person(pooled.count @ templates**2).max(axis=0)
    total = np.sum(np.where(usable, v, 0.0), axis=0)
    common = np.sum(np.where(usable, s, 0.0), axis=0) ** 2 / np.maximum(total, 1e-300)
    square = np.divide(s**2, v, out=np.zeros_like(s), where=usable)
    return square.sum(axis=0) - common, usable.sum(axis=0) - 1.0


def _in_windows(nodes: np.ndarray, inside: np.ndarray) -> np.ndarray:
    """Sums of nodes (2 G,) over the windows of magnitude and of phase, shape (2 B,)."""
    return np.asarray((nodes.reshape(2, -1) @ inside).ravel())


def normal_score(ratio: np.ndarray, freedom: np.ndarray, noise_freedom: np.ndarray) -> np.ndarray:
    """Standard normal score of an F ratio, by Wilson and Hilferty's cube-root approximation."""
    root = np.cbrt(ratio)
    a, b = 2.0 / (9.0 * np.maximum(freedom, 1e-3)), 2.0 / (9.0 * np.maximum(noise_freedom, 1e-3))
    return np.asarray((root * (1 - b) - (1 - a)) / np.sqrt(a + root**2 * b))


@dataclass(frozen=True)
class Null:
    """Null distribution of the largest of many statistics, when nothing is missing.

    Attributes
    ----------
    maxima : ndarray, shape (D,)
        Maximum of each draw, ascending.
    sides : int
        2 if the statistics are absolute values.
    number : int
        Number of statistics.
    """

    maxima: np.ndarray
    sides: int
    number: int

    def p_value(self, largest: float) -> float:
        """Probability of a maximum at least this large: from the draws within their range, else from the tail."""
        from scipy.special import ndtr

        knot = max(float(np.quantile(self.maxima, 1 - _CALIBRATED_AT)), 1.0)
        if not largest > knot:
            above = self.maxima.size - np.searchsorted(self.maxima, largest)
            return float((1 + above) / (1 + self.maxima.size))
        effective = _CALIBRATED_AT / (self.sides * ndtr(-knot))
        effective *= min((largest / knot) ** 2, max(self.number / effective, 1.0))
        return float(min(_CALIBRATED_AT, effective * self.sides * ndtr(-largest)))

    def threshold(self, p_value: float) -> float:
        """Smallest maximum with a p-value below the given one."""
        low, high = 0.0, 40.0
        for _ in range(40):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self.p_value(middle) > p_value else (low, middle)
        return high


def null_distributions(
    pooled: Pooled, windows: Windows, usable: np.ndarray, noise_freedom: int, rng: np.random.Generator, draws: int
) -> tuple[Null, Null]:
    """Null distributions of the largest |c| and of the largest normal score of the F ratios.

    Noise of single persons is drawn once; each simulated population is a random choice of such persons.

    Parameters
    ----------
    pooled : Pooled
    windows : Windows
    usable : ndarray of bool, shape (2 T + 2 B,)
        Templates and windows that remain visible beside the elements; a template only if its window does.
    noise_freedom : int
        Number of contrasts between repetitions; 0 if the noise is assumed.
    rng : numpy.random.Generator
    draws : int
    """
    covariance = pooled.covariance() / pooled.owner.size
    size = covariance.shape[0]
    factor = np.linalg.cholesky(covariance + 1e-9 * np.trace(covariance) / size * np.eye(size))
    noise = rng.normal(size=(draws, size)) @ factor.T
    expected = np.diag(covariance)
    t = 2 * windows.window.size
    templates = windows.templates()[:, usable[:t]]
    number, persons = templates.shape[1], pooled.persons
    area = _in_windows(expected, windows.inside)[usable[t:]]
    energy = ((noise**2).reshape(draws, 2, -1) @ windows.inside).reshape(draws, -1)[:, usable[t:]] / area
    among_persons = _resampling(draws, persons - 1, rng) if persons > 1 else None
    among_contrasts = _resampling(draws, noise_freedom, rng) if persons > 1 and noise_freedom else None
    level, level_freedom = np.ones((1, area.size)), np.full(area.size, np.inf)
    if among_contrasts is not None:
        level, level_freedom = among_contrasts @ energy, area * noise_freedom
    home = (np.cumsum(usable[t:]) - 1)[windows.home()[usable[:t]]]  # of each template, among the usable windows
    largest, ratio = np.zeros(draws), np.full(draws, -np.inf)
    for begin in range(0, number, _TEMPLATES_AT_ONCE):
        some = slice(begin, begin + _TEMPLATES_AT_ONCE)
        own = templates[:, some]
        score = noise @ own
        score /= np.sqrt(np.maximum(np.sum(own * (covariance @ own), axis=0), 1e-300))
        if among_persons is None:
            largest = np.maximum(largest, np.abs(score).max(axis=1))
            continue
        between, within = among_persons @ score**2, np.ones(1)
        coherent = np.abs(score) / np.sqrt(np.maximum(between, 1.0))
        largest = np.maximum(largest, coherent.max(axis=1))
        if among_contrasts is not None:
            within = np.maximum(among_contrasts @ score**2, level[:, home[some]])
        normal = normal_score(between / within, np.full(own.shape[1], persons - 1.0), level_freedom[home[some]])
        ratio = np.maximum(ratio, normal.max(axis=1))
    if among_persons is None:
        return Null(np.sort(largest), 2, number), Null(np.zeros(draws), 1, 1)
    normal = normal_score(among_persons @ energy / level, area * (persons - 1), level_freedom)
    ratio = np.maximum(ratio, normal.max(axis=1, initial=-np.inf))
    return Null(np.sort(largest), 2, number), Null(np.sort(ratio), 1, number + area.size)


def _resampling(n: int, size: int, rng: np.random.Generator) -> np.ndarray:
    """Matrix (n, n) that takes n rows to n means over `size` random ones of them."""
    chosen = rng.integers(n, size=(n, size)) + n * np.arange(n)[:, None]
    return np.bincount(chosen.ravel(), minlength=n * n).reshape(n, n) / size


def variances(covariance: np.ndarray, templates: np.ndarray) -> np.ndarray:
    """Variances of the scores of templates (2 G, M) with noise of some covariance (2 G, 2 G), shape (M,)."""
    return np.concatenate([np.einsum("gm,gm->m", own, covariance @ own) for own in _in_pieces(templates)])


def _in_pieces(templates: np.ndarray) -> list[np.ndarray]:
    """Views of a few templates each."""
    return [templates[:, b : b + _TEMPLATES_AT_ONCE] for b in range(0, templates.shape[1], _TEMPLATES_AT_ONCE)]


def visible(pooled: Pooled, windows: Windows, covariance: np.ndarray) -> np.ndarray:
    """Whether the elements leave enough of each template and of each window, bool, shape (2 T + 2 B,)."""
    templates, count = windows.templates(), pooled.count.sum(axis=0)
    left = variances(covariance, templates)
    area = _in_windows(np.diag(covariance), windows.inside)
    whole = np.concatenate([variances(np.diag(count), templates), _in_windows(count, windows.inside)])
    seen = np.concatenate([left, area]) > _ABSORBED * whole
    t = templates.shape[1]
    seen[:t] &= seen[t + windows.home()]
    return np.asarray(seen)


def refined(
    pooled: Pooled, scan: Windows, strength: np.ndarray, explained: Callable[[np.ndarray], np.ndarray]
) -> tuple[int, int, int, np.ndarray]:
    """The template that explains most, with its edges refined, because the scanned windows are an octave apart.

    Parameters
    ----------
    pooled : Pooled
    scan : Windows
    strength : ndarray, shape (2 T,)
        Strength of each template; the best constant, slope and bend are refined.
    explained : callable
        Chi-square explained by templates (2 G, M), shape (M,).

    Returns
    -------
    best : int
        Index of the template before refinement.
    low, high : int
        Refined edges, nodes low <= k < high.
    template : ndarray, shape (2 G,)
    """
    x, t = np.log(pooled.frequency_hz), scan.window.size
    g = x.size
    tried: list[tuple[int, int, int]] = []
    shapes: list[np.ndarray] = []
    for form in range(3):
        of_form = np.where(np.tile(scan.form, 2) == form, strength, -np.inf)
        best = int(np.argmax(of_form))
        if not of_form[best] > 0 and tried:
            continue
        low, high = int(scan.low[scan.window[best % t]]), int(scan.high[scan.window[best % t]])
        steps = np.unique(np.round(np.linspace(-0.5, 0.5, 9) * (high - low)).astype(int))
        edges = {(int(np.clip(low + i, 0, g - 1)), int(np.clip(high + j, 1, g))) for i in steps for j in steps}
        for a, b in sorted(e for e in edges | {(low, high)} if e[1] - e[0] >= min(3 if form == 0 else 6, high - low)):
            template = np.zeros(2 * g)
            template[best // t * g : (best // t + 1) * g] = shape_of(x, a, b, form)
            tried.append((best, a, b))
            shapes.append(template)
    chi = explained(np.array(shapes).T)
    form_of = scan.form[np.array([best % t for best, _, _ in tried])]
    most = np.array([chi[form_of == k].max() if np.any(form_of == k) else 0.0 for k in range(3)])[form_of]
    near = np.flatnonzero((chi >= most - _INDISTINCT) & (most >= chi.max() - _ALIKE)).tolist()
    chosen = min(near, key=lambda i: (tried[i][2] - tried[i][1], -chi[i]))
    return *tried[chosen], shapes[chosen]
