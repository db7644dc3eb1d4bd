"""An FMU with other start values in its description: the same archive, one member changed."""

import io
import zipfile
from xml.etree import ElementTree

from simulation.errors import InputError
from simulation.foreign_file import FMU, check_members, read_limited
from studies.exports.calibrated_values import CalibratedValues

DESCRIPTION = "modelDescription.xml"


def as_fmu(found: CalibratedValues) -> bytes:
    """Return the case's FMU whose description has the values as start values.

    The binary keeps its own defaults: whether they are replaced at the start is the importer's choice.

    Raises:
        InputError: The FMU is gone or damaged.
    """
    path, packed = found.case.fmu.path, io.BytesIO()
    try:
        with (
            zipfile.ZipFile(io.BytesIO(read_limited(path, FMU))) as old,
            zipfile.ZipFile(packed, "w") as new,
        ):
            check_members(old.infolist(), str(path))
            for member in old.infolist():
                content = old.read(member)
                if member.filename == DESCRIPTION:
                    content = _with_start_values(content, found)
                kept = zipfile.ZipInfo(member.filename, member.date_time)
                kept.compress_type, kept.create_system = member.compress_type, member.create_system
                kept.external_attr = member.external_attr  # which of them are programs
                new.writestr(kept, content)
    # RuntimeError: a member is encrypted.
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError) as error:
        raise InputError(f"{path}: cannot be unpacked ({error}); export it again") from None
    return packed.getvalue()


def _with_start_values(description: bytes, found: CalibratedValues) -> bytes:
    builder = ElementTree.TreeBuilder(insert_comments=True)
    root = ElementTree.fromstring(description, ElementTree.XMLParser(target=builder))
    values = {one.name: one for one in found.values}
    for element in root.iterfind("ModelVariables/*"):
        one = values.get(element.get("name", ""))
        if one is None:
            continue
        if found.case.fmu.fmi_version == "2.0":
            place, attribute = element.find(one.variable.kind), "start"
        elif one.variable.kind == "String":
            place, attribute = element.find("Start"), "value"
        else:
            place, attribute = element, "start"
        assert place is not None, "the description was read with this variable"
        place.set(attribute, one.text)
    # XML has no two hyphens in a comment.
    root.insert(0, ElementTree.Comment(f" {found.sentence.replace('--', '- -')} "))
    changed: bytes = ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)
    return changed
