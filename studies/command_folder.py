"""The temporary folder of one command: all that it and its processes make there goes when the command ends.

What a killed command leaves goes with the next one, whatever made it: figures, weights, unpacked FMUs.
"""

import atexit
import os
import tempfile
from contextlib import suppress

from simulation.errors import MachineError
from simulation.scratch import ScratchFolder

PREFIX = "studies-command-"


def give_temporary_folder() -> None:
    """Have temporary files of this process and of those it starts lie in one folder, as long as it lives.

    Where no folder can be made, whoever needs one says so.
    """
    with suppress(MachineError):
        scratch, owner = ScratchFolder(PREFIX), os.getpid()
        os.environ["TMPDIR"] = str(scratch.folder)
        tempfile.tempdir = None

        def remove() -> None:
            if os.getpid() == owner:  # a fork of it ends earlier
                scratch.remove()

        # Registered first, it is called last: after what ends the processes that use it.
        atexit.register(remove)
