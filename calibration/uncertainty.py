"""How well least squares determine their parameters: covariance, correlation, identifiability."""

from dataclasses import dataclass

import numpy as np

from calibration.descent import Descent
from calibration.parameters import Parameters

NOISE = 0.01  # of the data, against which identifiability is judged where residuals are smaller
LIMIT = 0.2  # share of a parameter, or product of parameters, that counts as undetermined


@dataclass(frozen=True)
class Uncertainty:
    """Gauss-Newton covariance s² (JᵀJ)⁻¹, s² = rᵀr/(m − k), at the end of a fit."""

    names: list[str]
    deviation: np.ndarray  # (k,) standard deviations of the parameters, in their units
    covariance: np.ndarray  # (k, k), in their units
    correlation: np.ndarray  # (k, k)
    singular: np.ndarray  # (k,) singular values of dr/d ln(parameter), largest first
    warnings: list[str]

    def correlations(self) -> list[str]:
        """A line for each pair of parameters."""
        return [
            f"correlation {self.names[j]}, {self.names[i]}: {self.correlation[i, j]:+.3f}"
            for i in range(len(self.names)) for j in range(i)
        ]  # fmt: skip

    def warned(self) -> list[str]:
        """The warnings as lines of a report."""
        return [f"warning: {line}" for line in self.warnings]

    def table(self) -> dict:
        """All of it for JSON; what is not finite as null."""
        return {
            "free": self.names, "standard_deviation": finite(self.deviation),
            "covariance": [finite(row) for row in self.covariance],
            "correlation": [finite(row) for row in self.correlation],
            "singular_values": finite(self.singular), "warnings": self.warnings,
        }  # fmt: skip


def finite(numbers) -> list:
    """Numbers for JSON, None where one is not finite."""
    return [float(x) if np.isfinite(x) else None for x in numbers]


def uncertainty(fit: Descent, parameters: Parameters, scale: float = 1.0) -> Uncertainty:
    """What a fit says of its parameters.

    `scale` is the size of the data in the units of the residual. The warning names the product
    of powers of the parameters, the right singular vector of the least singular value, that an
    error of 1 % in the data (or the residuals, if larger) would change by more than 20 %.
    """
    relative = fit.jacobian / np.asarray(parameters.relative(fit.theta))  # in ln(parameter)
    values = parameters.values(fit.theta)
    value = np.array([float(values[name]) for name in parameters.names])
    count, free = relative.shape
    error = float(np.linalg.norm(fit.residual)) / np.sqrt(max(count - free, 1))
    _, singular, rows = np.linalg.svd(relative, full_matrices=False)
    singular = np.pad(singular, (0, free - len(singular)))
    rows = rows if len(rows) == free else np.linalg.svd(relative)[2]
    with np.errstate(divide="ignore", invalid="ignore"):
        square = (rows.T / np.maximum(singular, 1e-150) ** 2) @ rows
        spread = np.sqrt(np.diag(square))
        covariance = error**2 * square * np.outer(value, value)
        return Uncertainty(
            parameters.names, error * spread * value, covariance, square / np.outer(spread, spread),
            singular, _undetermined(parameters.names, singular, rows, max(error, NOISE * scale)),
        )  # fmt: skip


def _undetermined(names, singular, rows, error):
    """A line for each direction in which the data leave the parameters free."""
    lines = []
    for strength, row in zip(singular, rows, strict=True):
        share = error / strength if strength > 0 else np.inf
        if share > LIMIT:
            row = row * np.sign(row[np.argmax(np.abs(row))])
            parts = [
                f"{name}^{power:.2f}"
                for name, power in zip(names, row, strict=True)
                if abs(power) > 0.1
            ]
            size = f"{100 * share:.0f} %" if share < 10 else "more than a factor of 10"
            lines.append(f"not determined by these data: {' '.join(parts)} is free within {size}")
    return lines
