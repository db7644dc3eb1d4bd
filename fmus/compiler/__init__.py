"""Compile a Modelica model to an FMU: `python -m fmus.compiler FOLDER`.

The way of a model: `modelica` reads the source and `events` takes its events out (both with pymoca), `causal`
solves its equations for the derivatives, `package` writes them as C (both with CasADi), compiles everything
with a wrapper in `c/` and packs the FMU. `model_description` says what its modelDescription.xml holds.
"""
