"""Errors of the operating system as one line of advice."""

from __future__ import annotations

import errno
import os

__all__ = ["advice_on", "in_one_line"]

_ELSEWHERE = "choose another place"
#: What to do, by the number of the error.
_REMEDIES = {
    errno.ENOSPC: "free some space; --resume goes on with a training from its last checkpoint",
    errno.EDQUOT: "free some space of your quota; --resume goes on with a training from its last checkpoint",
    errno.EFBIG: f"raise the limit on the size of a file, or {_ELSEWHERE}",
    errno.EROFS: _ELSEWHERE,
    errno.EACCES: f"ask for the right to use it, or {_ELSEWHERE}",
    errno.EPERM: f"ask for the right to use it, or {_ELSEWHERE}",
    errno.ENOENT: "check the path: a part of it is missing",
    errno.ENOTDIR: "check the path: a part of it that shall be a directory is a file",
    errno.EEXIST: "check the path: a part of it that shall be a directory is a file",
    errno.EISDIR: "name a file, not a directory",
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.ELOOP: "check the path: its links lead in a circle",
    errno.EMFILE: "raise the limit on open files (ulimit -n)",
    errno.ENFILE: "raise the limit on open files, or end other programs",
    errno.ENOMEM: "lower --num-envs, or end other programs",
    errno.EIO: f"check the disk, or {_ELSEWHERE}",
}


def in_one_line(error: Exception) -> str:
    """What an error says, in one line.

    Args:
        error: the error.

    Returns:
        The line.
    """
    return " ".join(str(error).split())


def advice_on(error: OSError) -> str:
    """Say in one line what the operating system refused, where, and what to do.

    Args:
        error: the error.

    Returns:
        The line.
    """
    if error.errno is None:
        return next((line for line in str(error).splitlines() if line.strip()), type(error).__name__)
    reason = f"{os.strerror(error.errno).lower()}; {_REMEDIES.get(error.errno, _ELSEWHERE)}."
    return f"{error.filename or 'a file'} cannot be read or written: {reason}"
