"""The benchmark of surrogates: problems, ours and their rivals, what is measured, table and picture."""
