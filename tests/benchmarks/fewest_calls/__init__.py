"""The benchmark of calibrations from no initial guess: problems, methods, counting, table and picture."""
