"""Random fields of strength: a factor of mean 1 with Weibull's distribution, correlated in space.

A Gaussian field g of variance 1 and correlation exp(−(r/length)²) is a sum of many plane waves of
random direction and phase (M. Shinozuka, G. Deodatis, Appl. Mech. Rev. 44 (1991) 191–204):

    g(x) = √(2/N) Σ cos(k_j · x + φ_j),   k_j normal with variance 2/length²,   φ_j uniform.

It is known everywhere, so that any grid samples the same field. The factor f with g's probability is

    P(f) = 1 − exp(−(f Γ(1 + 1/m))^m) = Φ(g),   mean 1.
"""

import zlib

import numpy as np

WAVES = 2048


def strength_factor(scatter, name: str, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Factors (nx, ny) on the strength of material `name` at the places x (nx,) × y (ny,), mm.

    `scatter`: that table of the material. Materials have fields of their own at the same seed.
    """
    random = np.random.default_rng([scatter.seed, zlib.crc32(name.encode())])
    if scatter.length == 0.0:
        return weibull(random.standard_normal((len(x), len(y))), scatter.modulus)
    return weibull(gaussian_field(random, scatter.length, x, y), scatter.modulus)


def gaussian_field(random: np.random.Generator, length: float, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A field (nx, ny) of mean 0, variance 1 and correlation exp(−(r/length)²) at x (nx,) × y (ny,), mm."""
    wave = random.standard_normal((2, WAVES)) * np.sqrt(2.0) / length
    phase = random.uniform(0.0, 2 * np.pi, WAVES)
    # cos(a + b) is the real part of a product, which makes a matrix product of the sum.
    along_x = np.exp(1j * np.outer(x, wave[0]))
    along_y = np.exp(1j * (np.outer(wave[1], y) + phase[:, None]))
    return np.sqrt(2.0 / WAVES) * (along_x @ along_y).real


def weibull(normal: np.ndarray, modulus: float) -> np.ndarray:
    """Weibull variates of mean 1 and this modulus with the probabilities of standard `normal` ones."""
    from scipy.special import gamma, log_ndtr

    return (-log_ndtr(-normal)) ** (1.0 / modulus) / gamma(1.0 + 1.0 / modulus)
