"""The report of a study: tables, sentences and figures of its typed results, and the page that holds them."""
