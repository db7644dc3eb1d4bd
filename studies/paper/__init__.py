"""The paper reproduced: one module per table or figure, run as stages, and a page that gathers them.

`catalog` lists the items, `plan` says how much is spent, `run` runs one, `gather` makes page and export.
"""
