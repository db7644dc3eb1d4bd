"""A public emulator package as it is meant to be used: autoemulate compares its own, the best one counts.

Release 2.1.2 cannot be installed beside this project: its requirements move torch back to 2.12. What its
emulators need runs with this project's torch, in an environment of its own that borrows this one's packages:

    python -m venv rivals
    echo "$PWD/.venv/lib/python3.11/site-packages" > rivals/lib/python3.11/site-packages/borrowed.pth
    rivals/bin/pip install --no-deps autoemulate torchmetrics lightning-utilities einops lightgbm torchrbf \\
        ipython
    rivals/bin/python tests/benchmarks/surrogate_rivals --methods autoemulate --json OTHER_FILE

and then `--from` with both files.
"""

import numpy as np
import torch
from autoemulate.core.compare import AutoEmulate

from simulation.arrays import FloatArray
from surrogate_rivals.coordinates import Clock, Features, Fitted, Principal
from surrogate_rivals.problems import Data

N_TRIED, N_SPLITS = 4, 2  # settings per emulator, parts of the cross-validation
CHUNK_ROWS = 200
LEFT_OUT = 1e-4  # of the variance: its processes are learnt for all coordinates at once


def best_of_six(data: Data, seed: int) -> Fitted:
    """Let the package tune its six default emulators on principal coordinates; take the best in validation.

    They are two Gaussian processes, radial basis functions, polynomials, a network, an ensemble of networks.
    """
    features, principal = Features.of(data.space), Principal.of(data, LEFT_OUT)
    z, z_validation = principal.coordinates(data.y), principal.coordinates(data.validation[1])
    size = float(np.sqrt((z**2).mean()))

    def rows(theta: FloatArray) -> torch.Tensor:
        return torch.from_numpy(features.both(theta)).float()

    compared = AutoEmulate(
        rows(data.theta),
        torch.from_numpy(z / size).float(),
        test_data=(rows(data.validation[0]), torch.from_numpy(z_validation / size).float()),
        n_iter=N_TRIED,
        n_splits=N_SPLITS,
        n_bootstraps=None,
        random_seed=seed,
        tuning_metric="rmse",
        evaluation_metrics=["rmse"],
        show_progress_bar=False,
        log_level="error",
    )
    best = compared.best_result("rmse")
    clock = Clock()
    compared.fit_from_reinitialized(rows(data.theta), torch.from_numpy(z / size).float(), best.id)
    fit_s = clock.s

    def predict(theta: FloatArray) -> FloatArray:
        # In parts, because its processes make the covariance of all rows that are asked for at once.
        found = [best.model.predict_mean(part).detach() for part in torch.split(rows(theta), CHUNK_ROWS)]
        return principal.outputs(torch.cat(found).double().numpy() * size)

    return Fitted(predict, fit_s, str(best.model_name))
