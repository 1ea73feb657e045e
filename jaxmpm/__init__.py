"""jaxmpm: a differentiable Material Point Method for fracture of quasi-brittle materials.

Units everywhere: mm, N, MPa, s, tonne; tension is positive.
"""

__version__ = "0.1.0"
