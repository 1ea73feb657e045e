"""What a body is made of below the size of a specimen: inclusions in a matrix, an interface, scatter.

The geometry is made once, in continuous coordinates (`placement`: inclusions of a `grading` with
`outlines` that keep their gap) or read from an `image` with labels; the grid only samples it
(`sampling`), so a finer cell sees the same structure. `scatter` is the random field of a strength.
NumPy only.
"""
