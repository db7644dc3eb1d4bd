"""The office zone's equations, written by hand from the paper."""

import numpy as np
from scipy.linalg import expm

# Name, estimate, lower and upper bound, unit (Table 1).
TABLE = (
    ("UWin", 0.7, 0.14, 3.5, "W/(m2.K)"),
    ("TTABSInit", 301.15, 293.15, 306.15, "K"),
    ("rInt", 0.18, 0.036, 0.9, "m2.K/W"),
    ("cInt", 182e3, 1e5, 4.5e5, "J/(m2.K)"),
    ("b", 5.0, 1.0, 25.0, "1"),
    ("rExt1", 1.06, 0.212, 5.3, "m2.K/W"),
    ("rExt2", 0.05, 0.01, 0.25, "m2.K/W"),
    ("cExt1", 8500.0, 1700.0, 42500.0, "J/(m2.K)"),
    ("cTABS", 7e5, 1.4e5, 3.5e6, "J/(m2.K)"),
    ("rPipe", 0.122, 0.0244, 0.61, "m2.K/W"),
    ("rZone", 0.183, 0.0366, 0.915, "m2.K/W"),
    ("VSUP", 0.0111, 0.00222, 0.0555, "m3/s"),
    ("fSol", 0.1, 0.02, 0.5, "m2"),
    ("qIntOcc", 12.0, 2.4, 60.0, "W/m2"),
)
NAMES = tuple(row[0] for row in TABLE)
LOWER = np.array([row[2] for row in TABLE])
UPPER = np.array([row[3] for row in TABLE])
INPUTS = ("TAmb", "TAmbEq", "TSupTAC", "ySupTAC", "TSupMV", "ySupMV", "HGlo", "occ")
STEP_S = 600.0
T_WALL_K = 280.0


def random_theta(n, seed):
    """Draw parameter sets in the bounds, in logarithmic coordinates. Shape (n, 14)."""
    u = np.random.default_rng(seed).random((n, len(TABLE)))
    return LOWER * (UPPER / LOWER) ** u


def varied_inputs(n_steps, seed):
    """Make inputs that all vary and switch both circuits, each held over a step. Shape (n_steps, 8)."""
    rng = np.random.default_rng(seed)
    hour = np.arange(n_steps) * STEP_S / 3600.0
    sun = 400.0 * np.clip(np.sin(2 * np.pi * (hour - 6.0) / 24.0), 0.0, None) * rng.uniform(0.5, 1.0, n_steps)
    ambient = 270.0 + 5.0 * np.sin(2 * np.pi * (hour - 9.0) / 24.0) + rng.normal(0.0, 0.5, n_steps)
    return np.column_stack(
        [
            ambient,
            ambient + 0.02 * sun,
            300.0 + 3.0 * np.sin(hour / 7.0),
            rng.choice([0.0, 0.05, 0.1, 0.11, 0.5, 1.0], n_steps),
            292.0 + 2.0 * np.cos(hour / 5.0),
            rng.choice([0.0, 0.0999, 0.1001, 1.0], n_steps),
            sun,
            rng.random(n_steps),
        ]
    )


def network(theta, inputs):
    """Give A and b of ``T' = A T + b`` for T = (air, internal masses, wall, ceiling). [1/s], [K/s]."""
    p = dict(zip(NAMES, theta, strict=True))
    t_e, t_eq, t_sup, y_sup, t_mv, y_mv, irr, occ = inputs
    g_int, g_win, g_zone = 36.1589 / p["rInt"], p["UWin"] * 2.626, 11.935 / p["rZone"]
    g_1, g_2 = 4.888 / p["rExt1"], 4.888 / p["rExt2"]
    g_pipe = 11.935 / p["rPipe"] if y_sup > 0.1 else 1e-6
    g_mv = p["VSUP"] * 1204.8 if y_mv > 0.1 else 1e-6
    q = p["qIntOcc"] * 12.72 * occ
    capacities = np.array(
        [p["b"] * 1.23 * 1008.0 * 36.7608, p["cInt"] * 12.72, p["cExt1"] * 4.888, p["cTABS"] * 11.935]
    )
    flows = np.array(
        [
            [-g_win - g_mv - g_int - g_1 - 0.04 * g_zone, g_int - 0.16 * g_zone, g_1, 0.2 * g_zone],
            [g_int - 0.16 * g_zone, -g_int - 0.64 * g_zone, 0.0, 0.8 * g_zone],
            [g_1, 0.0, -g_1 - g_2, 0.0],
            [0.2 * g_zone, 0.8 * g_zone, 0.0, -g_pipe - g_zone],
        ]
    )
    sources = np.array(
        [
            g_win * t_e + g_mv * t_mv + 0.09 * p["fSol"] * irr + 0.3 * q,
            0.91 * p["fSol"] * irr + 0.7 * q,
            g_2 * t_eq,
            g_pipe * t_sup,
        ]
    )
    return flows / capacities[:, None], sources / capacities


def start(theta, t_air):
    """Give the four temperatures at the start. [K]."""
    return np.array([t_air, t_air, T_WALL_K, theta[NAMES.index("TTABSInit")]])


def solve_exactly(theta, inputs, t_air):
    """Step by the matrix exponential. Air temperature at the steps' edges. Shape (n_steps + 1,). [K]."""
    temperatures = start(theta, t_air)
    air = [t_air]
    for row in inputs:
        matrix, source = network(theta, row)
        augmented = np.zeros((5, 5))
        augmented[:4, :4], augmented[:4, 4] = matrix, source
        temperatures = (expm(augmented * STEP_S) @ np.append(temperatures, 1.0))[:4]
        air.append(temperatures[0])
    return np.array(air)
