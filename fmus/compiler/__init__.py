"""Compile a Modelica model to an FMI 2.0 FMU: `python -m fmus.compiler FOLDER`.

The way of a model: `modelica` reads the source (the only module that knows pymoca), `causal` solves its
equations for the derivatives, `code` writes them as C (both with CasADi), `description` writes
modelDescription.xml, and `package` compiles everything with the wrapper in `c/` and packs the FMU.
"""
