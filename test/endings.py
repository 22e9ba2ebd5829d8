"""How processes of nodes may end."""

import warnings

WATCHDOG = 'Timeout (0:00:05)!'  # what faulthandler says


def check(code: int, said: str):
    """Check that a node that was told to stop ended with code 0 and without a traceback.

    The middleware has been seen to hang in its own end, once in a thousand processes: the node
    is then ended by its watchdog, which shows where. That is for a warning.
    """
    if code == 1 and WATCHDOG in said:
        warnings.warn(f'the middleware did not end by itself:\n{said}', stacklevel=2)
        said = said[:said.index(WATCHDOG)]
    else:
        assert code == 0, said
    assert 'Traceback' not in said, said
