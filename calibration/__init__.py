"""Parameters of band laws from what was measured: fracture energy, softening curves.

Units everywhere: mm, N, MPa; tension is positive.
"""
