"""Errors of this package; each says what is wrong, why, and what to do."""


class MvSlapseError(Exception):
    """Any mistake that the caller can mend; ``exit_code`` is what the command line returns."""

    exit_code = 3


class UsageError(MvSlapseError):
    """A wrong argument, setting or parameter."""

    exit_code = 2


class UnusableInput(MvSlapseError):  # noqa: N818 (the input is at fault, no error is)
    """A video, bag or camera file that cannot be used."""

    exit_code = 3


class MissingKernels(MvSlapseError):  # noqa: N818 (as above: the installation is incomplete)
    """The compiled module is not installed, or does not fit this Python."""

    exit_code = 3
    cure = ('run `make setup` in the clone, or build the workspace again with colcon, or install '
            'mv_slapse again with pip; each needs CMake, a C++ compiler and pybind11')


class UnusableOutput(MvSlapseError):  # noqa: N818 (the disk is at fault)
    """A place where results cannot be written: full, read-only or not permitted."""

    exit_code = 3
