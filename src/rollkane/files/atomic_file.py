"""Files that appear whole or not at all."""

import os
import uuid
from pathlib import Path


def write_whole(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file so that nobody ever sees half of it.

    The bytes go to a new file beside the target, which then takes its name in one
    step. After a failure the target is what it was before, and nothing else is left.

    Args:
        path: Target; its folder must exist. A link is followed.
        data: Everything that the file shall hold.

    Raises:
        OSError: the folder does not exist, the target is not an ordinary file, or the
            system refuses to write.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        raise OSError(f"{target} is not an ordinary file; give another name")
    if not target.parent.is_dir():
        raise FileNotFoundError(
            f"folder {target.parent} does not exist; make it, or give another name"
        )
    part = target.parent / f".{target.name[:200]}.{uuid.uuid4().hex}.part"
    try:
        with open(part, "xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, target)
    finally:
        part.unlink(missing_ok=True)
