"""Where the program holds and where it fails, on one page: every panel a file that measures, tells and draws.

A panel has a `NAME`, a one-line `TITLE`, and `measure(say)`: what it has found as plain numbers, with `rows` of `series`, `x`
and `y` among them, None where a run fails; `lines(found)`: the same in words; `draw(axes, found)`.
"""
