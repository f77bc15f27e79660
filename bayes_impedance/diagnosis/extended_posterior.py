r"""Parameters of effects that were found, from the population's posterior of the network with these effects in it.

The search (:mod:`bayes_impedance.diagnosis.selection`) decides what is missing, with approximations that let it try
hundreds of candidates. What was found is then part of a network like any other, whose population is estimated as every
population is (:mod:`bayes_impedance.population.fit`): elements, effects and their distributions together.

An effect's parameters x follow from the network's, :math:`x = g(\theta)`: a time constant is the product of a damper
and a compliance, for example (:attr:`bayes_impedance.network.operation_traits.Traits.read`). The value of the median
person is :math:`g(\mu)`, and with T the covariance of :math:`\theta` between people, the dispersion of :math:`\ln x`
(or of another link) is

.. math:: s = \sqrt{\nabla g^T\,T\,\nabla g},

which is exact where :math:`\ln x` is linear in the logarithms of the network's parameters.
"""

from __future__ import annotations

import numpy as np

from bayes_impedance.diagnosis.catalogue.coefficient import Coefficient
from bayes_impedance.diagnosis.extended_network import ExtendedNetwork
from bayes_impedance.diagnosis.fit.coefficient_posterior import CoefficientPosterior
from bayes_impedance.diagnosis.fit.model import Model
from bayes_impedance.network.extensions import PowerLaw
from bayes_impedance.network.kernel import Kernel
from bayes_impedance.network.parameters import quantity_of
from bayes_impedance.population.fit import PopulationFit

_STEP = 1e-4
"""Step of the derivative with respect to unbounded parameters, whose natural unit is one. Its error is that of the
second derivative times this."""

_LARGEST_LOG = 1.0
"""Largest standard deviation of a logarithm for which the mean of a log-normal distribution is formed: beyond it the
mean is far above most people's values."""


def extended_posterior(model: Model, extended: ExtendedNetwork, fit: PopulationFit) -> CoefficientPosterior:
    """Posterior of a model's additions.

    Parameters
    ----------
    model : Model
        With at least one addition.
    extended : ExtendedNetwork
        Of that model, or of one with further additions after these.
    fit : PopulationFit
        Of the extended network.
    """
    read = Reading(model, extended, fit.kernel)
    mu = fit.parameters.mu
    values, sign = read(mu)
    tau = np.nan_to_num(fit.parameters.between_persons)  # of one person there is none
    root = tau[:, :, None] * fit.parameters.correlation_cholesky
    gradient = np.zeros((*values.shape, mu.shape[1]))
    for k in np.flatnonzero(tau.any(axis=0)).tolist():
        there = mu.copy()
        there[:, k] += _STEP
        gradient[:, :, k] = (read(there)[0] - values) / _STEP
    spread = np.linalg.norm(gradient @ root, axis=2)
    central, relative = values.copy(), spread
    for k, p in enumerate(model.parameters):
        addition = model.additions[p.addition]
        if not p.is_coefficient or not addition.effect.operation:
            continue
        if not addition.effect.signed and addition.pooling != "shared":
            # The search describes such a coefficient by mean and relative standard deviation: those of a log-normal.
            s = np.minimum(spread[:, k], _LARGEST_LOG)
            central[:, k], relative[:, k] = sign[:, k] * np.exp(values[:, k] + 0.5 * s**2), np.sqrt(np.expm1(s**2))
        else:
            central[:, k] = sign[:, k] * np.exp(values[:, k])
    shared = np.array([p.shared for p in model.parameters], dtype=bool)
    relative[:, shared] = 0.0
    covariance = np.atleast_2d(np.cov(central.T))
    return CoefficientPosterior(
        central=central,
        relative_dispersion=relative,
        covariance=covariance,
        settled=not fit.diagnostics.problems,
        elements=read.elements(mu),
    )


class Reading:
    """The unbounded parameters u of a model's additions, from those of the extended network.

    Of a linear coefficient: the logarithm of its absolute value, and its sign.
    """

    def __init__(self, model: Model, extended: ExtendedNetwork, kernel: Kernel) -> None:
        self.model, self.extended = model, extended
        self.column = {name: k for k, name in enumerate(kernel.elements)}
        self.by_name = {p.name: p for p in kernel.parameters}
        self.laws = {n.size.name: n for _, n in kernel.network.walk() if isinstance(n, PowerLaw)}

    def __call__(self, theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """From sets (S, P) to u and signs, each (S, A)."""
        result = np.empty((len(theta), len(self.model.parameters)))
        sign = np.ones_like(result)
        for i, addition in enumerate(self.model.additions):
            columns = [c - self.model.n_elements for c in self.model.columns(i)]
            symbols = self.extended.symbols[i]
            if not addition.effect.operation:
                result[:, columns] = theta[:, [self.column[name] for name in symbols.values()]]
                continue
            values = {letter: self.value(name, theta) for letter, name in symbols.items()}
            x = addition.effect.traits.read(values)
            for c, own, coefficient in zip(columns, x, addition.effect.coefficients, strict=True):
                result[:, c], sign[:, c] = self.unbounded(coefficient, own)
        return result, sign

    def value(self, name: str, theta: np.ndarray) -> np.ndarray:
        """Value of a parameter of the network as it stands in the formulas, a power law's size in the band's middle."""
        own = self.by_name[name].value(theta[:, self.column[name]]) * quantity_of(name).factor
        if name in self.laws:
            own = own * self.at_middle(name, theta)
        return np.asarray(own)

    def at_middle(self, name: str, theta: np.ndarray) -> np.ndarray:
        """Ratio of a power law's size in the band's middle to that at its reference frequency."""
        law = self.laws[name]
        a = law.exponent
        reference = 2 * np.pi * law.reference_hz if law.reference_hz else 1.0
        exponent = a.value if a.value is not None else self.by_name[a.name].value(theta[:, self.column[a.name]])
        return np.asarray((self.model.scales.middle / reference) ** (exponent - 1))

    def unbounded(self, coefficient: Coefficient, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The coefficient's u, of a linear one its logarithm; and the sign."""
        if coefficient.link == "logit":
            return np.log(x / (1 - x)), np.ones_like(x)
        if coefficient.link == "linear":
            x = x / coefficient.scale(self.model.scales)
        with np.errstate(divide="ignore"):
            return np.log(np.abs(x)), np.sign(x)

    def elements(self, theta: np.ndarray) -> np.ndarray:
        """Log elements (P, S) of the network as given; of a spring that became a power law, in the band's middle."""
        rows = []
        replaced = {  # further additions may follow in the extended network
            addition.place: symbols["own_p"]
            for addition, symbols in zip(self.model.additions, self.extended.symbols, strict=False)
            if "own_p" in symbols
        }
        for name in self.model.network.elements:
            if name in self.column:
                rows.append(theta[:, self.column[name]])
            elif name in replaced:
                rows.append(-np.log(self.value(replaced[name], theta) * self.model.scales.middle))
            else:
                rows.append(np.full(len(theta), np.nan))
        return np.array(rows)
