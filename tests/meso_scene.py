"""A square of mortar with stones and an interface, for tests."""

from jaxmpm.scene import Scene

LAWS = {
    "mortar": (2.2e-9, 25000.0, 0.2, {"law": "damage", "ft": 3.0, "Ep": 8.0, "n": 0.15, "h": 0.005}),
    "stone": (2.7e-9, 60000.0, 0.3, None),
    "itz": (2.0e-9, 15000.0, 0.25, {"law": "damage", "ft": 1.5, "Ep": 8.0, "n": 0.15, "h": 0.005}),
}
STONES = {"fraction": 0.4, "grading": {"kind": "fuller", "smallest": 2.0, "largest": 6.0}, "gap": 0.4}


def tree(cell=0.5, size=24.0, mesostructure=None, scatter=None, **changes):
    """Nested tables; `mesostructure` adds to and, with None, takes from that table; `scatter` by material."""
    box = lambda low, high: {"kind": "rectangle", "min": low, "max": high}  # noqa: E731
    materials = {}
    for name, (density, E, nu, band) in LAWS.items():
        materials[name] = {"density": density, "bulk": {"law": "elastic", "E": E, "nu": nu}}
        materials[name] |= {"band": dict(band)} if band else {}
    for name, table in (scatter or {}).items():
        materials[name]["scatter"] = table
    table = {
        "body": "block", "inclusion": "stone", "interface": "itz", "interface_thickness": 0.5, "inclusions": STONES,
    } | (mesostructure or {})  # fmt: skip
    return {
        "title": "block",
        "grid": {"size": [size, size], "cell": cell, "stress_state": "plane_stress", "thickness": 10.0},
        "materials": materials,
        "bodies": [{"name": "block", "material": "mortar", "shapes": [box([0.0, 0.0], [size, size])]}],
        "mesostructure": {key: value for key, value in table.items() if value is not None},
        "sets": {"bottom": {"inside": [box([0.0, 0.0], [size, 0.0])]}, "top": {"inside": [box([0.0, size], [size, size])]}},
        "supports": [{"set": "bottom", "fix": ["x", "y"]}],
        "displacements": [{"set": "top", "direction": "y", "history": {"time": [0, 1e-4], "value": [0, 1e-3]}}],
        "gauges": {"load": {"kind": "reaction", "set": "top", "direction": "y"}},
        "solver": {"duration": 1e-4, "frame": "total"},
    } | changes


def scene(**changes):
    return Scene.from_dict(tree(**changes))
