r"""The log density of one person's recordings by brute force, without any step of the package.

The log elements :math:`\theta_j` of the J repetitions are jointly normal, with mean mu and covariance
:math:`\Sigma + \delta_{jk} R`. The likelihood of all of them, with the noise scale integrated out, is evaluated on a
dense grid over all J P of them and added up. There are no means over repetitions, no contrasts, no Laplace, no draws.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln, logsumexp

from bayes_impedance.recordings.files import Recordings, Subject

Float = NDArray[np.float64]
ALPHA = 2.0
"""Shape and rate of the inverse gamma prior of the squared noise scale, as README and DESIGN promise."""


def one_damper(theta: Float, omega: Float) -> NDArray[np.complex128]:
    return np.exp(theta[..., :1]) * np.ones(omega.size)


def mass_and_damper(theta: Float, omega: Float) -> NDArray[np.complex128]:
    return np.exp(theta[..., 1:]) + 1j * omega * np.exp(theta[..., :1])


def measured(omega: Float, z: NDArray[np.complex128], n_elements: int) -> Float:
    """Log elements that fit one recording, shape (P,): only to know where the grid has to be."""
    damper = np.log(np.mean(z.real))
    return np.array([damper] if n_elements == 1 else [np.log(omega @ z.imag / (omega @ omega)), damper])


def log_density(
    impedance, frequency_hz: Float, z: NDArray[np.complex128], sigma: Float, mu: Float, cov: Float, rho: Float, n: int
) -> float:
    """Log density of z (J, F), noise sigma (J, F), under N(mu, cov) and rho (P,): n points in each dimension."""
    omega, p, repetitions = 2 * np.pi * frequency_hz, mu.size, len(z)
    places, chi, log_cell = [], [], 0.0
    for j in range(repetitions):
        centre = measured(omega, z[j], p)
        step = 1e-5
        slopes = np.array(
            [
                (impedance(centre + step * e, omega) - impedance(centre - step * e, omega)) / (2 * step)
                for e in np.eye(p)
            ]
        )
        sd = np.array([np.sum(np.abs(s / sigma[j]) ** 2) ** -0.5 for s in slopes])
        axes = [c + np.linspace(-9, 9, n) * s for c, s in zip(centre, sd, strict=True)]
        log_cell += float(np.sum(np.log([axis[1] - axis[0] for axis in axes])))
        grid = np.stack([a.ravel() for a in np.meshgrid(*axes, indexing="ij")], axis=-1)
        places.append(grid - mu)
        chi.append(np.sum(np.abs((impedance(grid, omega) - z[j]) / sigma[j]) ** 2, axis=1))
    joint = np.kron(np.ones((repetitions, repetitions)), cov) + np.kron(np.eye(repetitions), np.diag(rho**2))
    precision = np.linalg.inv(joint).reshape(repetitions, p, repetitions, p)

    def along(values: Float, *axes: int) -> Float:
        shape = [1] * repetitions
        for axis, size in zip(axes, values.shape, strict=True):
            shape[axis] = size
        return values.reshape(shape)

    square, total = 0.0, 0.0
    for j in range(repetitions):
        total = total + along(chi[j], j)
        square = square + along(np.einsum("gp,pq,gq->g", places[j], precision[j, :, j], places[j]), j)
        for k in range(j):
            cross = places[k] @ precision[k, :, j] @ places[j].T
            square = square + 2 * along(cross, k, j)
    count = z.size
    log_prior = -0.5 * square - 0.5 * np.linalg.slogdet(2 * np.pi * joint)[1]
    log_likelihood = ALPHA * np.log(ALPHA) - gammaln(ALPHA) + gammaln(ALPHA + count) - count * np.log(2 * np.pi)
    log_likelihood = log_likelihood - 2 * np.sum(np.log(sigma)) - (ALPHA + count) * np.log(ALPHA + 0.5 * total)
    return float(logsumexp(log_prior + log_likelihood) + log_cell)


def recordings_of(impedance, network: str, mu: Float, repetitions: list[int], points: int, seed: int) -> Recordings:
    """People whose elements differ by a quarter and repetitions by a twentieth, with noise of a twentieth."""
    rng, frequency = np.random.default_rng(seed), np.geomspace(5.0, 50.0, points)
    subjects = []
    for i, j in enumerate(repetitions):
        theta = mu + 0.25 * rng.normal(size=mu.size) + 0.05 * rng.normal(size=(j, mu.size))
        z = impedance(theta, 2 * np.pi * frequency)
        noise = rng.normal(size=z.shape) + 1j * rng.normal(size=z.shape)
        z = z + 0.05 * np.exp(0.2 * rng.normal()) * np.abs(z) * noise
        names = tuple(str(k + 1) for k in range(j))
        subjects.append(Subject(name=f"P{i:02}", frequency_hz=frequency, z=z, repetitions=names))
    return Recordings(
        title="tiny",
        unit="N s/m",
        network=network,
        source="simulated",
        licence="MIT",
        subjects=tuple(subjects),
        sha256="",
        warnings=(),
    )
