"""Units that an FMU leaves unsaid: many tools write none, and then only the case can know them."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from simulation.case_file import CaseFile, InputTable, OutputTable
from simulation.errors import InputError
from simulation.fmi.description import FmuDescription


def said_units(file: CaseFile) -> dict[str, str]:
    """Return the units that the case says in place of the FMU, by variable."""
    tables: list[InputTable | OutputTable] = [*file.inputs, *file.outputs]
    return {table.name: table.fmu_unit for table in tables if table.fmu_unit is not None}


def with_units(fmu: FmuDescription, units: Mapping[str, str], path: Path) -> FmuDescription:
    """Return the description with units for variables that it declares none for.

    Args:
        fmu: The description.
        units: Units by variable.
        path: The case file, for messages.

    Raises:
        InputError: If the FMU declares another one.
    """
    changed = {}
    for name, unit in units.items():
        variable = fmu.variables.get(name)
        if variable is None:
            continue  # Said where names are checked.
        if variable.unit and variable.unit != unit:
            raise InputError(
                f'{path}: {name}: fmu_unit = "{unit}" contradicts the FMU\'s "{variable.unit}"; drop it, and '
                "give in unit what the CSV file holds"
            )
        changed[name] = replace(variable, unit=unit)
    return replace(fmu, variables={**fmu.variables, **changed}) if changed else fmu
