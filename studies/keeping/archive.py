"""Archives of studies: one compressed file with checksums, made whole or not at all, read with suspicion."""

import hashlib
import io
import json
import tarfile
import zlib
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path, PurePosixPath
from typing import Any, Final

from simulation.errors import InputError
from studies.keeping.stores import OnProgress
from studies.tracking.origin import versions

FORMAT: Final = 1
MANIFEST: Final = "archive.json"
_BLOCK: Final = 2**20
_TOPS: Final = (("mlruns",), ("data",))
"""First parts of the names that an archive may hold."""


def pack(folder: Path, file: Path, said: Mapping[str, Any], on_progress: OnProgress) -> int:
    """Write all files of a folder to an archive.

    Args:
        folder: what is packed; it is laid out as a project.
        file: the archive; it must not exist.
        said: what its manifest tells besides files and checksums.
        on_progress: told of bytes packed, and how many there are.

    Returns:
        The archive's size. [byte]
    """
    files = sorted(found for found in folder.rglob("*") if found.is_file())
    total, done = sum(found.stat().st_size for found in files), 0
    scratch = file.with_name(f".{file.name}-new")
    try:
        with tarfile.open(scratch, "w:gz", compresslevel=6) as archive:
            listing = {}
            for found in files:
                name = found.relative_to(folder).as_posix()
                on_progress(done, total)
                archive.add(found, name, filter=_plain)
                content = found.read_bytes()
                listing[name] = {"sha256": hashlib.sha256(content).hexdigest(), "size": len(content)}
                done += len(content)
            manifest = {
                "format": FORMAT,
                "made": datetime.now(UTC).isoformat(timespec="seconds"),
                "versions": versions(),
                **said,
                "files": listing,
            }
            text = (json.dumps(manifest, indent=1, sort_keys=True) + "\n").encode()
            member = tarfile.TarInfo(MANIFEST)
            member.size, member.mtime = len(text), int(datetime.now(UTC).timestamp())
            archive.addfile(member, io.BytesIO(text))
        scratch.replace(file)
    except BaseException:
        scratch.unlink(missing_ok=True)
        raise
    return file.stat().st_size


def unpack(file: Path, folder: Path, on_progress: OnProgress) -> dict[str, Any]:
    """Unpack an archive into an empty folder, and check every file against its checksum.

    Args:
        file: the archive.
        folder: where to.
        on_progress: told of bytes read, and how many there are.

    Returns:
        The archive's manifest.

    Raises:
        InputError: it is no archive of studies, damaged, of a newer version, or tries to write elsewhere.
    """
    size = file.stat().st_size
    found: dict[str, dict[str, Any]] = {}
    try:
        with file.open("rb") as raw, tarfile.open(fileobj=raw, mode="r:gz") as archive:
            for member in archive:
                on_progress(min(raw.tell(), size), size)
                place = _place(file, folder, member)
                place.parent.mkdir(parents=True, exist_ok=True)
                found[member.name] = _extract(archive, member, place)
    except (tarfile.TarError, EOFError, zlib.error, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise
        raise InputError(f"{file} is damaged or no archive of studies ({error}); copy it again") from None
    found.pop(MANIFEST, None)
    manifest = _manifest(file, folder / MANIFEST)
    declared = manifest["files"]
    for name in sorted(set(declared) | set(found)):
        if declared.get(name) != found.get(name):
            what = "is missing" if name not in found else "is not what was packed"
            raise InputError(f"{file}: {name} {what}; copy the archive again")
    return manifest


def _plain(member: tarfile.TarInfo) -> tarfile.TarInfo:
    """Leave out who packed a file."""
    member.uid = member.gid = 0
    member.uname = member.gname = ""
    member.mode = 0o644
    return member


def _place(file: Path, folder: Path, member: tarfile.TarInfo) -> Path:
    name = PurePosixPath(member.name)
    is_inside = not name.is_absolute() and ".." not in name.parts and "\\" not in member.name
    is_ours = member.name == MANIFEST or name.parts[:1] in _TOPS
    if not (member.isfile() and is_inside and is_ours):
        raise InputError(f"{file} holds {member.name!r}, which is none of ours; nothing was imported")
    return folder / name


def _extract(archive: tarfile.TarFile, member: tarfile.TarInfo, place: Path) -> dict[str, Any]:
    source = archive.extractfile(member)
    assert source is not None
    digest, size = hashlib.sha256(), 0
    with source, place.open("xb") as target:
        while block := source.read(_BLOCK):
            digest.update(block)
            size += len(block)
            target.write(block)
    return {"sha256": digest.hexdigest(), "size": size}


def _manifest(file: Path, place: Path) -> dict[str, Any]:
    try:
        manifest = json.loads(place.read_text(encoding="utf-8"))
        number, files = manifest["format"], manifest["files"]
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(
            f"{file} is damaged or no archive of studies (no readable {MANIFEST}); copy it again"
        ) from None
    if number != FORMAT or not isinstance(files, dict):
        raise InputError(
            f"{file} is of format {number}, this version reads {FORMAT}; import it with the one that wrote it"
        )
    assert isinstance(manifest, dict)
    return manifest
