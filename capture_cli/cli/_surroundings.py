"""Surroundings of a run: the current folder, names that can be written, and what the system refuses."""

import errno
import os
import sys
from pathlib import Path

from capture_cli.errors import CaptureError, OptionError, OutputError

CURES = {  # by what the system says
    errno.ENOSPC: "free some space, or send stdout elsewhere",
    errno.EDQUOT: "free some space, or send stdout elsewhere",
    errno.ENAMETOOLONG: "give a shorter path",
    errno.EMFILE: "let more files be open (ulimit -n 4096)",
    errno.ENOMEM: "ask for less at once: a shorter log or --duration, fewer --pairs, episodes or --starts",
}


def check_surroundings() -> None:
    """Raise OptionError where the current folder is gone, or it or an argument has a name that is not UTF-8."""
    try:
        folder = str(Path.cwd())
    except FileNotFoundError:
        raise OptionError(
            "the current folder was deleted", cure="go to one that exists (cd), and run the command again"
        ) from None
    for name in (folder, *sys.argv[1:]):
        try:
            name.encode("utf-8")
        except UnicodeEncodeError:
            where = "the current folder" if name is folder else "the argument"
            raise OptionError(
                f"{where} {name!a} is not UTF-8, and what is written names it so",
                cure="give the file or the folder another name (mv); or, if others read it well, set LC_ALL=C.UTF-8",
            ) from None


def of_the_system(error: OSError) -> CaptureError | None:
    """The error of what the system refused; None where it does not say on which file."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT) and error.filename is None:
        # of --out those who write it say so
        return OutputError("the disk is full: what goes to stdout was not written", cure=CURES[error.errno])
    if error.errno is None or (error.filename is None and error.errno not in CURES):
        return None
    named = "" if error.filename is None else f"{os.fsdecode(error.filename)}: "
    usual = "check the path, its permissions, and those of the folders above it"
    return OptionError(f"{named}{error.strerror}", cure=CURES.get(error.errno, usual))
