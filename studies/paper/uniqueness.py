"""How unique a calibration is (the paper's sec. 3.3.2): many optima, clustered, and why they differ."""

import warnings
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from typing import Any

import numpy as np
from scipy.cluster.vq import ClusterError, kmeans2

from simulation.arrays import FloatArray, IntArray
from simulation.errors import InputError
from studies.paper.direct import direct_folder, run_direct_row
from studies.paper.direct_crew import OnStart
from studies.paper.direct_row import TOLERANCE_TRF, DirectRow
from studies.stages.calibrate import write_arrays
from studies.stages.pipeline import Study, digest_of, read_json, write_json
from studies.stages.results import read_arrays
from studies.uncertainty.identifiability import Identifiability, correlated_pairs, identifiability

N_STARTS = 256
N_CLUSTERS = 10
N_LARGEST = 3
BEST_SHARE = 0.05
"""The paper's numbers of starts, centroids, clusters shown, and its best 5 %."""

MANY_RESTARTS = 20
"""Beginnings of k-means; the tightest clusters are kept."""

SAME_ERROR = 1.01
"""Optima with errors up to this many times the best are taken for the same minimum."""

GOOD = 1.2
"""Optima with errors up to this many times the best are those whose parameters are correlated."""

NAMED = 0.6
"""Correlation over good optima from which a pair is named."""

MEAN_PAPER, BEST_PAPER = 0.0364, 0.0114
"""MSE of the paper's 256 starts: their mean, and that of the best 5 %. [K²]"""


def uniqueness_rows(seed: int = 0, n_starts: int = N_STARTS) -> dict[str, DirectRow]:
    """List what is looked at: the paper's starts, those with squared residuals, and with patience.

    "patient" has SciPy's own tolerance and the case's scales: it tells minima from searches that stopped.
    """
    paper = DirectRow("ls-trf", n_starts, "residuals", "physical", seed, tolerance=TOLERANCE_TRF)
    return {
        "paper": paper,
        "squared": replace(paper, objective="squared"),
        "patient": replace(paper, coordinates="log", tolerance=None),
    }


@dataclass(frozen=True)
class Clusters:
    """Optima grouped by nearness.

    Attributes:
        labels: Cluster of each optimum, numbered from the largest. Shape (n,).
        centers: Shape (k, p). [as the optima]
        sizes: Shape (k,).
        inertia: Sum of squared distances to the centers.
    """

    labels: IntArray
    centers: FloatArray
    sizes: IntArray
    inertia: float


def cluster(points: FloatArray, n_clusters: int, seed: int) -> Clusters:
    """Group points with k-means: k-means++ beginnings, the tightest of several.

    Args:
        points: Shape (n, p).
        n_clusters: Number of centroids; as many as there are different points at most.
        seed: Seed of the beginnings.
    """
    n_clusters = min(n_clusters, len(np.unique(points, axis=0)))
    rng = np.random.default_rng(seed)
    best: tuple[float, FloatArray, IntArray] | None = None
    for _ in range(MANY_RESTARTS):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # an empty cluster is an error here, and tried again
                centers, near = kmeans2(points, n_clusters, iter=100, minit="++", missing="raise", rng=rng)
        except ClusterError:
            continue
        inertia = float(np.sum((points - centers[near]) ** 2))
        if best is None or inertia < best[0]:
            best = (inertia, np.array(centers, dtype=np.float64), np.array(near))
    if best is None:
        raise InputError(
            f"k-means finds no {n_clusters} clusters in {len(points)} optima; give fewer clusters"
        )
    inertia, middles, labels = best
    sizes = np.bincount(labels, minlength=n_clusters)
    order: IntArray = np.argsort(-sizes, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(n_clusters)
    return Clusters(place[labels], middles[order], sizes[order], inertia)


def run_uniqueness(
    study: Study, row: DirectRow, on_start: OnStart | None = None, *, n_clusters: int = N_CLUSTERS
) -> dict[str, Any]:
    """Compute the optima of many starts, cluster them, and say which parameters compensate each other.

    Args:
        study: The study.
        row: The starts, see `uniqueness_rows`.
        on_start: Told how far the starts are.
        n_clusters: Number of centroids.

    Returns:
        The numbers; the same as in `<row.name>.uniqueness.json`, with arrays beside it.
    """
    starts = run_direct_row(study, row, on_start)
    file = direct_folder(study) / f"{row.name}.uniqueness.json"
    digest = digest_of({"starts": starts["digest"], "n_clusters": n_clusters})
    finished = read_json(file)
    if finished is not None and finished.get("digest") == digest and file.with_suffix(".npz").is_file():
        return finished
    found = read_arrays(direct_folder(study) / f"{row.name}.npz")
    space = study.case.parameter_space
    theta, mse = np.asarray(found["theta"], dtype=np.float64), np.asarray(found["mse"], dtype=np.float64)
    u = space.to_unit(theta)
    groups = cluster(u, n_clusters, row.seed)
    best = np.argsort(mse, kind="stable")[: max(1, round(BEST_SHARE * len(mse)))]
    good = mse <= GOOD * mse.min()
    over_optima = optima_correlation(u[good])
    with study.case.open_model() as model:
        local = identifiability(model, study.case.measurement, theta[best[0]])
    numbers = {
        "digest": digest,
        "name": row.name,
        "title": f"{row.title}, {row.objective} in {row.coordinates} coordinates",
        "row": asdict(row),
        "command": f"studies reproduce-paper {study.command} --only fig8".replace("  ", " "),
        "label": study.label,
        "n_calls": starts["n_calls"] + local.n_calls,
        "wall_s": starts["wall_s"],
        "n_starts": len(mse),
        "mse_best": float(mse.min()),
        "mse_best_5_percent": float(mse[best].mean()),
        "mse_median": float(np.median(mse)),
        "mse_mean": float(mse.mean()),
        "n_at_best": int(np.sum(mse <= SAME_ERROR * mse.min())),
        "n_good": int(good.sum()),
        "paper": {"mse_best_5_percent": BEST_PAPER, "mse_mean": MEAN_PAPER},
        "clusters": [
            {
                "size": int(size),
                "mse_best": float(mse[groups.labels == k].min()),
                "mse_median": float(np.median(mse[groups.labels == k])),
                "center": dict(zip(space.names, space.from_unit(center).tolist(), strict=True)),
            }
            for k, (size, center) in enumerate(zip(groups.sizes, groups.centers, strict=True))
        ],
        "pairs_over_optima": [pair.to_dict() for pair in correlated_pairs(space.names, over_optima, NAMED)],
        "spread_over_best": dict(zip(space.names, np.ptp(u[best], axis=0).tolist(), strict=True)),
        "identifiability": local.to_dict(),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
    }
    write_arrays(
        file.with_suffix(".npz"),
        {
            "u": u,
            "theta": theta,
            "mse": mse,
            "labels": groups.labels,
            "centers": groups.centers,
            "best": best,
            "good": good,
            "optima_correlation": over_optima,
            **_arrays_of(local),
        },
    )
    write_json(file, numbers)
    return numbers


def optima_correlation(u: FloatArray) -> FloatArray:
    """Return the correlation of parameters over optima; 0 for one that is the same in all. Shape (p, p).

    Args:
        u: Optima in the unit cube. Shape (n, p). [1]
    """
    n, p = u.shape
    centered = u - u.mean(axis=0)
    deviation = np.sqrt(np.mean(centered**2, axis=0))
    moving = deviation > 1e-9
    if n < 3:
        return np.eye(p)
    normed = np.where(moving, centered / np.where(moving, deviation, 1.0), 0.0)
    correlation: FloatArray = np.clip(normed.T @ normed / n, -1.0, 1.0)
    return correlation


def _arrays_of(local: Identifiability) -> dict[str, FloatArray]:
    return {
        "local_correlation": local.correlation,
        "local_alignment": local.alignment,
        "local_spread": local.spread,
        "singular_values": local.singular_values,
        "directions": local.directions,
    }
