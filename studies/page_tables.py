"""Tables of the report's page on a terminal."""

from studies.blocks import Column, Table
from studies.report.tables import Table as PageTable


def terminal_table(table: PageTable) -> Table:
    """Return a table of the page as one of the terminal: the same cells, units in the headings."""
    titles = [f"{column.title} [{column.unit}]" if column.unit else column.title for column in table.columns]
    columns = [
        Column(title, table.is_numeric(k), column.spare)
        for k, (title, column) in enumerate(zip(titles, table.columns, strict=True))
    ]
    return Table(table.title, columns, table.texts(), is_dense=True)
