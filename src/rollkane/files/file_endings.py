"""Endings of files that are written, and what each stands for.

No import of JAX: the command line looks at names before it starts anything.
"""

from pathlib import Path

PICTURES = (".png", ".svg", ".pdf")
NETCDF = (".nc", ".nc4", ".h5", ".hdf5")  # NetCDF-4 is HDF5
TABLES = (".csv",)
PAGES = (".html", ".htm")
JSON = (".json",)
ANIMATIONS = (".gif",)
VIDEOS = (".mp4",)
MODELS = (".glb",)


def ending(path: object) -> str:
    """The ending of a file's name, in lower case with its dot; empty where none is."""
    return Path(str(path)).suffix.lower()


def wrong_ending(path: object, known: tuple[str, ...]) -> tuple[str, str] | None:
    """What is wrong with a file's ending and what to do, or None where nothing is.

    Args:
        path: The file.
        known: Endings that can be written, in lower case.
    """
    found = ending(path)
    if found in known:
        return None
    problem = f"the ending {found} is not known" if found else "has no ending"
    one_of = " or ".join([", ".join(known[:-1]), known[-1]] if known[1:] else known)
    return problem, f"end the name in {one_of}, which says what is written"
