"""FMUs for Windows: their library lives in a worker program under Wine, which is asked by messages."""

import contextlib
import struct
from pathlib import Path, PureWindowsPath
from typing import NamedTuple

import numpy as np

from simulation.arrays import FloatArray
from simulation.errors import InputError
from simulation.fmi.cosimulation import why_failed
from simulation.fmi.description import FmuDescription
from simulation.fmi.log import forget_messages, note_message
from simulation.fmi.loop import FUNCTIONS
from simulation.fmi.row_calls import Experiment, RowCalls, RunPlan, Setting
from simulation.fmi.runner import FmuProcessEnded
from simulation.fmi.status import WARNING, Instance
from simulation.fmi.variable import Interface
from simulation.fmi.wine import WineWorker

# As in simulation/worker/fmu_worker.c.
_NOT_LOADED, _NO_FUNCTION, _NO_INSTANCE = 200, 201, 202
_PLAIN, _EXPERIMENT, _CONSTANT, _PARAMETER = range(4)
_HEAD = struct.Struct("<iiidI")


class _Answer(NamedTuple):
    status: int
    stage: int
    step: int
    reached: float
    n_said: int


class WindowsFmu(Instance):
    """An instance of an FMU for Windows, and the Solver that takes it through a row of co-simulation."""

    def __init__(
        self, description: FmuDescription, interface: Interface, folder: Path, plan: RunPlan
    ) -> None:
        """Start the worker, load the library and make the first instance.

        Args:
            description: What the FMU says of itself.
            interface: "co-simulation".
            folder: Where it is unpacked.
            plan: What is set, stepped through and read.

        Raises:
            InputError: If the library cannot be loaded or refuses to be instantiated.
        """
        super().__init__(description.path, description.fmi_version)
        found = description.interface(interface, str(description.path))
        fixed = (one for one, _ in plan.fixed)
        for one in (*plan.calibrated, *fixed, *plan.input_variables, *plan.outputs):
            if one.array:
                raise InputError(
                    f"{description.path}: {one.name} is of an array, which is used of FMUs for Linux alone; "
                    "export or compile it for Linux"
                )
        self._plan = plan
        self._row = RowCalls(plan, self.version)
        self._names = [name for name, _ in self._row.calls] + [*FUNCTIONS]
        self._names += [one.function for one in self._row.inputs]
        self._worker = WineWorker(folder)
        try:
            self._read(_HEAD.size)  # that it has started
            answer = self._ask(
                b"L" + self._loading(found.model_identifier, description.guid, folder, found.binary)
            )
            self._check_loaded(answer)
        except BaseException:
            self._worker.close()
            raise

    def solve(self, values: FloatArray, y: FloatArray) -> str:
        """Simulate one row; see Solver.

        Raises:
            FmuProcessEnded: If the FMU took the worker along.
        """
        self._row.fill(values)
        answer = self._ask(b"S" + b"".join(one.values.tobytes() for one in self._row.parameters))
        if answer.status <= WARNING:
            y[:] = np.frombuffer(self._read(y.nbytes), "<f8").reshape(y.shape)
        name = self._names[answer.stage]
        return why_failed(self, self._plan, answer.status, name, answer.step, answer.reached)

    def reset(self) -> bool:
        """Ask the FMU to be as if just instantiated; see Instance."""
        return self._ask(b"R").status <= WARNING

    def replace(self) -> None:
        """Free the instance and make a new one; see Instance."""
        answer = self._ask(b"N" + bytes([self.damaged]))
        self.damaged = False
        if answer.status > WARNING:
            self.lost = answer.status != _NO_INSTANCE
            raise self.no_other()

    def close(self) -> None:
        """Free the instance and end the worker; closing twice does no harm."""
        self._worker.close(_message(b"Q" + bytes([self.damaged])))

    def _check_loaded(self, answer: _Answer) -> None:
        said = self._said
        if answer.status == _NOT_LOADED:
            raise self.not_loaded(said)
        if answer.status == _NO_FUNCTION:
            raise self.no_function(said)
        if answer.status == _NO_INSTANCE:
            raise self.refusal()

    # Messages

    def _ask(self, message: bytes) -> _Answer:
        forget_messages()
        with contextlib.suppress(OSError):  # that it has ended shows when its answer is read
            self._worker.send(_message(message))
        answer = _Answer(*_HEAD.unpack(self._read(_HEAD.size)))
        self._said = self._read(answer.n_said).decode("utf-8", "replace")
        note_message(self._said)
        return answer

    def _read(self, n: int) -> bytes:
        content = self._worker.read(n)
        if len(content) < n:
            raise FmuProcessEnded(self._worker.exit_code())
        return content

    def _loading(self, identifier: str, guid: str, folder: Path, binary: str) -> bytes:
        """Return what the worker's load() reads."""
        resources = folder / "resources"
        if self.version == "2.0":
            place = resources.as_uri().replace("file:///", "file:///Z:/", 1)
        else:
            # The standard wants the folder to end with a separator.
            place = f"{_on_windows(resources)}\\"
        texts = (_on_windows(folder / binary), identifier, guid, place)
        parts = [_number(int(self.version[0])), *map(_text, texts), _number(len(self._row.calls))]
        for name, given in self._row.calls:
            parts.append(_text(self.full_name(name)))
            if isinstance(given, Setting):
                is_parameter = any(given is one for one in self._row.parameters)
                parts += [_number(_PARAMETER if is_parameter else _CONSTANT), _values(given, n_steps=1)]
            elif isinstance(given, Experiment):
                parts.append(
                    struct.pack(
                        "<IIddd", _EXPERIMENT, given.is_asked, given.tolerance, given.start, given.stop
                    )
                )
            else:
                parts.append(_number(_PLAIN))
        parts.append(_number(len(self._row.inputs)))
        for one in self._row.inputs:
            parts += [_text(self.full_name(one.function)), _values(one, n_steps=self._plan.n_steps)]
        references, edges = self._plan.output_references, self._plan.edges
        parts += [_number(len(references)), references.tobytes(), _number(self._plan.scenario.output_every)]
        parts += [_number(len(edges)), edges.tobytes()]
        return b"".join(parts)


def _message(content: bytes) -> bytes:
    return _number(len(content)) + content


def _on_windows(path: Path) -> str:
    """Return a path as Wine has it, which shows this machine's files as drive Z."""
    return str(PureWindowsPath(f"Z:{path}"))


def _number(value: int) -> bytes:
    return struct.pack("<I", value)


def _text(text: str) -> bytes:
    content = text.encode()
    return _number(len(content)) + content


def _values(one: Setting, *, n_steps: int) -> bytes:
    """Return what the worker's next_values() reads."""
    size = 0 if one.texts else one.values.itemsize
    head: bytes = struct.pack("<III", len(one.columns), size, n_steps) + one.references.tobytes()
    if one.texts:
        return head + b"".join(_number(len(text)) + text for text in one.texts)
    return head + np.ascontiguousarray(one.values[:n_steps]).tobytes()
