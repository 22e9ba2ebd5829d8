"""The compiled kernels, or an error that says how to get them.

Every other module calls a kernel as ``binding.compiled.NAME(...)``. A kernel is a pure function
of arrays: it keeps no state and reads no settings.
"""

from importlib import import_module
from types import ModuleType

from mv_slapse.errors import MissingKernels

NAME = 'mv_slapse_kernels'


def load() -> ModuleType:
    """Return the compiled module.

    Raises
    ------
    MissingKernels
        Where it is not installed, or was built for another Python or another machine.
    """
    try:
        return import_module(NAME)
    except ImportError as error:
        raise MissingKernels(f'the compiled kernels ({NAME}) cannot be loaded: {error}; '
                             f'{MissingKernels.cure}') from error


compiled = load()
