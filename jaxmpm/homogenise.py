"""What a representative volume is like as one material: stiffness, strength and fracture energy of a run with [macro].

The volume's mean stress σ̄ against its mean strain ε̄ gives, by least squares through the origin over
the rise up to a share of the peak, k = Σ σ̄ ε̄ / Σ ε̄². Where one normal component is driven and the
others are free, in plane stress k = E and −Σ ε̄_across ε̄ / Σ ε̄² = ν; in plane strain the two are
E/(1 − ν²) and ν/(1 − ν). Where shear is all that is driven, k = G.
"""

from collections.abc import Mapping

import numpy as np

from jaxmpm.macro import COMPONENTS

RISE = 0.3  # of the peak: up to there the volume is as good as elastic
UNITS = {
    "E": "MPa", "nu": "", "G": "MPa", "strength": "MPa", "strain_at_strength": "", "stress_left": "",
    "fracture_energy": "N/mm",
}  # fmt: skip


def homogenised(scene, history: Mapping[str, np.ndarray]) -> dict:
    """The numbers of a volume as one material, as far as its gauges tell them.

    Args:
        scene: a Scene with a table [macro].
        history: columns of its history by name, (rows,) each, at least one row (`results.read_history`).

    Returns:
        `component`, the one that is driven (the most, if several are), and of

        - `E`, MPa, and `nu`: one normal component is driven, the others are free; nu needs a mean
          strain gauge across the pull, and so does E in plane strain;
        - `G`, MPa: shear is driven, other components are free or held at zero;
        - `strength`, MPa: largest mean stress of the component, in magnitude; `strain_at_strength`;
        - `stress_left`: share of it that is left at the end. Only where that is near zero has the
          volume broken and is its fracture energy complete; at 1 it has not passed its peak;
        - `fracture_energy`, N/mm: energy dissipated so far over the section across the pull (of shear: along x).

        Left out is what the drive does not determine, or what no gauge measures.
    """
    component = driven_component(scene.macro)
    columns = _columns(scene, history)
    energy = {"fracture_energy": float(history["dissipated_energy"][-1] / section(scene.grid, component))}
    stress, strain = columns.get(("stress", component)), columns.get(("strain", component))
    if stress is None or not np.abs(stress).max() > 0:
        return {"component": component} | energy
    peak = int(np.abs(stress).argmax())
    found = {"component": component}
    if strain is not None:
        across = columns.get(("strain", {"xx": "yy", "yy": "xx"}.get(component)))
        found |= _stiffness(scene, stress, strain, across) | {"strain_at_strength": float(abs(strain[peak]))}
    left = float(abs(stress[-1] / stress[peak]))
    return found | {"strength": float(abs(stress[peak])), "stress_left": left} | energy


def driven_component(macro) -> str:
    """The component of the mean strain that is driven the most, the first of several that are."""
    driven = macro.strain.driven()
    return max(driven, key=lambda name: abs(driven[name]))


def section(grid, component: str) -> float:
    """Area, mm², across the pull of a normal component; of shear, along x."""
    return grid.size[1 if component == "xx" else 0] * grid.thickness


def rise(stress: np.ndarray) -> slice:
    """The rows before the stress first passes its share RISE of the peak, in magnitude."""
    passed = np.abs(stress) > RISE * np.abs(stress).max()
    return slice(0, int(passed.argmax()))


def slope(y: np.ndarray, x: np.ndarray) -> float | None:
    """Of the line through the origin that is nearest to y (rows,) over x by least squares; None where x stays zero."""
    square = float(x @ x)
    return float(y @ x) / square if square > 0 else None


def _columns(scene, history) -> dict[tuple[str, str], np.ndarray]:
    """Mean stresses and strains that are measured: ("stress" or "strain", component) to (rows,)."""
    kinds = {"mean_stress": "stress", "mean_strain": "strain"}
    return {
        (kinds[gauge.kind], gauge.component): np.asarray(history[name])
        for name, gauge in scene.gauges.items()
        if gauge.kind in kinds
    }


def _stiffness(scene, stress, strain, across) -> dict:
    """E and nu, or G, where the drive determines them."""
    driven = scene.macro.strain.driven()
    rows = rise(stress)
    k = slope(stress[rows], strain[rows])
    if k is None:
        return {}
    if {name for name in COMPONENTS if driven.get(name)} == {"xy"}:
        return {"G": k}
    if len(driven) > 1:
        return {}
    ratio = None if across is None else -slope(across[rows], strain[rows])
    if scene.grid.stress_state == "plane_strain":
        if ratio is None:
            return {}
        nu = ratio / (1.0 + ratio)
        return {"E": k * (1.0 - nu**2), "nu": nu}
    return {"E": k} if ratio is None else {"E": k, "nu": ratio}
