"""The paper's own numbers (doi 10.3384/ecp204107), as printed or read from its text."""

from dataclasses import dataclass

USUAL_MSE = 0.0121
"""What the paper's method ends at with 32 simulations (Table 4). [K²]"""

N_IMPORTANT = 6
"""Parameters that sec. 3.2 calls the most important."""


@dataclass(frozen=True)
class PublishedCalibration:
    """One row of Table 4.

    Args:
        mse_screened: MSE by the FMU at the screened point. [K²]
        mse_polished: final MSE; the column "MSE PELS-VAE + GA" repeats it in all nine rows, a slip. [K²]
        total: calls of training set and polish; validation and test sets are left out.
    """

    mse_screened: float
    mse_polished: float
    total: int


TABLE_4 = {
    32: PublishedCalibration(1.0623, 0.0121, 260),
    64: PublishedCalibration(1.6390, 0.0128, 188),
    128: PublishedCalibration(3.4509, 0.0122, 299),
    256: PublishedCalibration(0.7498, 0.0117, 562),
    512: PublishedCalibration(0.2486, 0.0124, 651),
    1024: PublishedCalibration(0.0816, 0.0133, 1089),
    1536: PublishedCalibration(0.0298, 0.0128, 1616),
    2048: PublishedCalibration(0.2080, 0.0135, 2113),
    4096: PublishedCalibration(0.0326, 0.0118, 4297),
}
"""By training-set size."""

FIG_6_MAE = {32: 2.0, 1024: 0.1, 4096: 0.07}
"""Best test MAE that sec. 3.2 names, days 8 to 16. [K]"""

FIG_6_RANGE = (256, 0.4, 1.1)
"""Where hyperparameters matter, in its words: size, lowest and highest MAE. [K]"""

TABLE_3 = (
    ("LS-TRF", 1, 261, 0.0117),
    ("SLSQP", 1, 650, 0.0149),
    ("LS-TRF", 16, 3486, 0.0114),
    ("Nelder-Mead", 1, 5000, 0.0126),
    ("Powell", 1, 5000, 0.0881),
    ("LS-TRF", 32, 6311, 0.0114),
    ("LS-TRF", 64, 12612, 0.0113),
    ("SLSQP", 16, 18245, 0.0117),
    ("Nelder-Mead", 16, 76483, 0.0117),
    ("Powell", 16, 79120, 0.0134),
    ("SLSQP", 64, 86322, 0.0114),
    ("Nelder-Mead", 64, 286728, 0.0110),
    ("Powell", 64, 319322, 0.0125),
    ("Differential evolution", 1, 748020, 0.0104),
    ("Nelder-Mead", 256, 1188496, 0.0111),
)
"""Optimizer, starts, model calls, MSE at the end [K²]."""

FIG_8_MEAN, FIG_8_BEST = 0.0364, 0.0114
"""MSE of 256 starts of LS-TRF: their mean, and that of the best 5 %. [K²]"""
