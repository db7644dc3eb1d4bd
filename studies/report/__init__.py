"""Reports: tables and figures made from results that lie on disk."""
