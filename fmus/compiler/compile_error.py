"""The one error of the compiler."""


class CompileError(ValueError):
    """A model, a build file or a toolchain that cannot be compiled; one line that says why and what to do."""
