"""The paper reproduced: one module per table or figure, over what the other commands share.

`items` makes and shows one, `plan` says how much is spent.
"""

ITEMS = {
    "fig6": "error of every trial over the training simulations, days 8 to 16",
    "fig7": "error of the best of Fig. 6, trained again, toward the middle of the box",
    "table3": "SciPy's optimizers straight on the FMU (Tables 2 and 3)",
    "fig8": "256 starts of LS-TRF: how unique is a calibration",
    "table4": "screening and polish with the best of Fig. 6 (Table 4 and Fig. 9)",
}
ALIASES = {"table2": "table3", "fig9": "table4"}
NEEDS_FIG6 = ("fig7", "table4")
DRAWN = ("fig6", "fig7", "table4")
"""Items that can be drawn from the files of an earlier run, without the recording."""
