"""A surrogate as an ONNX graph answers as the surrogate itself."""

from __future__ import annotations

import numpy as np
import pytest
from rc_step_for_tests import PROCESSES, SMALL, rc_step

from pelsvae.config import SurrogateConfig
from pelsvae.mean_surrogate import MeanSurrogate
from pelsvae.onnx_file import onnx_bytes
from pelsvae.training import fit

NETWORK, LINEAR = SMALL.replace(max_epochs=5), PROCESSES.replace(n_members=2, max_epochs=2)
SAME = 1e-6  # relative to the largest value of an output: inside, networks compute in single precision


# A network with residual layers is asked in tests/end_to_end, where a page writes one.
# What was hardly fitted is answered the same.
@pytest.mark.parametrize(
    "configs",
    [[NETWORK], [LINEAR], [NETWORK, LINEAR]],
    ids=["plain", "processes", "mean"],
)
def test_any_number_of_rows_is_answered_in_physical_units(configs: list[SurrogateConfig]) -> None:
    onnxruntime = pytest.importorskip("onnxruntime", reason="pip install -e '.[onnx]'")
    validation = rc_step(20, seed=2, n_outputs=2)
    data = rc_step(16, seed=1, n_outputs=2)
    each = [fit(*data, validation, config=one, seed=0).surrogate for one in configs]
    surrogate = each[0] if len(each) == 1 else MeanSurrogate(tuple(each), (0.25, 0.75))
    content = onnx_bytes(surrogate, metadata={"case": "step"})
    assert __file__.rpartition("/tests")[0].encode() not in content
    session = onnxruntime.InferenceSession(content)
    assert session.get_modelmeta().custom_metadata_map == {"case": "step"}
    for n in (1, 7, 300):
        theta, _ = rc_step(n, seed=5)
        (y,) = session.run(["y"], {"theta": theta})
        expected = surrogate.predict(theta)
        assert (y.dtype, y.shape) == (np.float64, expected.shape)
        assert (np.abs(y - expected) <= SAME * np.abs(expected).max(axis=(0, 1))).all()
