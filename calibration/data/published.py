"""The bundled softening curves from their published formulae: `python -m calibration.data.published`.

They are formulae evaluated for f_t = 3 MPa and G_F = 0.11 N/mm, not measurements.
"""

from pathlib import Path

import numpy as np

FT, GF = 3.0, 0.11


def hordijk(w, ft=FT, GF=GF):
    """Hordijk (1991): c₁ = 3, c₂ = 6.93, w_c = 5.136 G_F/f_t; w (m,), mm, to σ (m,), MPa."""
    x = w / (5.136 * GF / ft)
    end = (1 + 3.0**3) * np.exp(-6.93)
    return np.where(x < 1, ft * ((1 + (3.0 * x) ** 3) * np.exp(-6.93 * x) - x * end), 0.0)


def petersson(w, ft=FT, GF=GF):
    """Petersson (1981): (0, f_t), (0.8 G_F/f_t, f_t/3), (3.6 G_F/f_t, 0) joined by lines."""
    return ft * np.interp(w * ft / GF, [0.0, 0.8, 3.6], [1.0, 1 / 3, 0.0])


def model_code(w, ft=FT, GF=GF):
    """fib Model Code 2010: (0, f_t), (G_F/f_t, 0.2 f_t), (5 G_F/f_t, 0) joined by lines."""
    return ft * np.interp(w * ft / GF, [0.0, 1.0, 5.0], [1.0, 0.2, 0.0])


PUBLISHED = {
    "hordijk_1991": (
        hordijk,
        5.136,
        "D.A. Hordijk, Local approach to fatigue of concrete, PhD thesis, TU Delft, 1991.",
        "sigma/ft = (1 + (c1 w/wc)^3) exp(-c2 w/wc) - (w/wc)(1 + c1^3) exp(-c2), "
        "c1 = 3, c2 = 6.93, wc = 5.136 GF/ft",
    ),
    "petersson_1981": (
        petersson,
        3.6,
        "P.E. Petersson, Crack growth and development of fracture zones in plain concrete and "
        "similar materials, report TVBM-1006, Lund, 1981.",
        "bilinear through (0, ft), (0.8 GF/ft, ft/3), (3.6 GF/ft, 0)",
    ),
    "model_code_2010": (
        model_code,
        5.0,
        "fib Model Code for Concrete Structures 2010, section 5.1.8.2.",
        "bilinear: sigma = ft (1 - 0.8 w/w1) to w1 = GF/ft, then ft (0.25 - 0.05 w/w1) to wc = 5 GF/ft",
    ),
}


def text(name: str) -> str:
    """The file of a curve."""
    function, last, source, formula = PUBLISHED[name]
    w = np.linspace(0.0, last, 61) * GF / FT
    rows = [f"{x:.6f},{y:.6f}" for x, y in zip(w, np.abs(function(w)), strict=True)]
    about = (
        f"# {source}\n# {formula}\n"
        f"# Evaluated for ft = {FT:g} MPa, GF = {GF:g} N/mm; a formula, not a measurement.\n"
    )
    return about + "\n".join(["w [mm],sigma [MPa]", *rows]) + "\n"


if __name__ == "__main__":
    for name in PUBLISHED:
        (Path(__file__).parent / f"{name}.csv").write_text(text(name))
